"""Whole runs of the command line inside MPI."""

import json
import sys
from types import SimpleNamespace

import pytest
import tomli_w
from petsc4py import PETSc

from pdpetsc import cli
from pdpetsc import options as petsc_options


@pytest.fixture(autouse=True)
def options(monkeypatch):
    """Put PETSc's options and the exception hook back afterwards."""
    monkeypatch.setattr(sys, "excepthook", sys.excepthook)
    petsc_options.set_defaults({})
    database = PETSc.Options()
    before = database.getAll()
    yield
    petsc_options.set_defaults({})
    for name in database.getAll():
        if name not in before:
            database.delValue(name)


@pytest.fixture
def run(comm, shared_tmp_path, capsys, monkeypatch):
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
        petsc_options.set_defaults({})  # those of an earlier run: what follows is the user's
        for name, value in (petsc or {}).items():
            PETSc.Options()[name] = value
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
