"""Whole runs of the command line inside MPI."""

import json
from types import SimpleNamespace

import pytest
import tomli_w

from pdpetsc import cli


@pytest.fixture
def run(comm, shared_tmp_path, capsys, monkeypatch, petsc_options):
    """`run(document, *arguments, out=..., petsc={...})`: the command line in this process.

    Gives exit code, directory, summary (None when there is none), and what this rank said.
    """
    monkeypatch.chdir(shared_tmp_path)

    def run(document, *arguments, out="out", petsc=None):
        word = document
        if not isinstance(document, str):
            word = "my.toml"
            if comm.rank == 0:
                (shared_tmp_path / word).write_text(tomli_w.dumps(document))
        petsc_options(**(petsc or {}))
        comm.Barrier()
        capsys.readouterr()
        code = cli.main([word, "--out", str(shared_tmp_path / out), *arguments])
        said = capsys.readouterr()
        assert set(comm.allgather(code)) == {code}
        comm.Barrier()
        directory = shared_tmp_path / out
        path = directory / "summary.json"
        summary = json.loads(path.read_text()) if path.exists() else None
        return SimpleNamespace(code=code, out=directory, summary=summary, said=said.out, errors=said.err)

    return run
