"""What a stranger's file must not do: run code, write elsewhere, read other files, take all memory, or never end."""

import json
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from conftest import environment_for_mpirun
from fuzzing import SUMMARY, write_checkpoint, write_fields

from pdpetsc import apart, case, catalogue, hdf5_check, pictures
from pdpetsc.body import meshfile
from pdpetsc.body.meshes import surface_of_mesh
from pdpetsc.errors import InputError
from pdpetsc.io import kept, tables, trust
from pdpetsc.io.checkpoint import CHECKPOINT
from pdpetsc.io.fields import HDF5
from pdpetsc.io.report import write_report
from pdpetsc.io.view import View

BAR = catalogue.bundled()["bar_tension"].read_text()


def load(tmp_path, *overrides: str, text: str = BAR, name: str = "bar.toml"):
    path = tmp_path / name
    path.write_text(text)
    return case.load(str(path), overrides)


def refusal(function, *arguments, **more) -> str:
    with pytest.raises(InputError) as error:
        function(*arguments, **more)
    assert "\n" not in str(error.value) and len(str(error.value)) < 2000
    return str(error.value)


# PETSc's options


@pytest.mark.parametrize(
    "option",
    [
        "options_file=/x", "log_view=:/tmp/x", "ksp_view=:/etc/x", "snes_monitor=ascii:x", "dll_append=x.so",
        "dll_prepend=x", "library_preload=x", "mat_view=binary:x", "mat_view=binary", "info=x", "Info=x",
        "malloc_dump=x", "malloc_view=x", "python=x", "pc_type=python", "pc_python_type=os.system",
        "ksp_monitor_python=a.b", "mg_levels_1_ksp_type=PYTHON", "SNES_PYTHON_TYPE=a.b", "on_error_attach_debugger=gdb",
        "start_in_debugger=true", "debug_terminal=xterm", "fp_trap=true", "history=x", "log_all=x", "log_trace=x",
        "citations=x", "viewer_binary_filename=x", "ts_trajectory_dirname=x", "ts_monitor_solution_vtk=x-%03d.vtu",
        "ksp_view=socket", "saws_port=80", "display=host:0", "draw_save=x", "prefix_push=x", "options_string=x",
        "mat_mumps_icntl_1=99", "mat_mumps_icntl_22=1", "log_view=::ascii_info,:x", "mat_view=ascii,binary",
        "mat_mumps_ooc_tmpdir=x", "mpi_linear_solver_server=true", "tmp=x",
        "ksp_monitor='-options_file'", "ksp_rtol=../x", "ksp_monitor_ratio=x", "x_pc_python_type=x", "log_mpe=x",
    ],
)  # fmt: skip
def test_options_of_a_case_touch_neither_code_nor_files(tmp_path, option):
    assert f"petsc.{option.partition('=')[0]}: " in refusal(load, tmp_path, f"petsc.{option}")


@pytest.mark.parametrize(
    "option",
    [
        "ksp_rtol=1e-10", "snes_monitor=true", "pc_type=gamg", "pc_factor_mat_solver_type=mumps", "log_view=true",
        "ksp_view='::ascii_info_detail'", "ksp_converged_reason=true", "mat_mumps_icntl_14=50", "options_left=true",
        "mg_levels_ksp_type=chebyshev", "pd_tangent=matrix_free", "snes_linesearch_type=bt", "ts_adapt_type=none",
        "mg_levels_esteig_ksp_max_it=10", "pc_gamg_threshold=-1.0", "pc_hypre_type=boomeramg", "options_view=true",
        "ksp_monitor_true_residual=true", "pc_fieldsplit_type=additive", "info_exclude=null",
    ],
)  # fmt: skip
def test_options_that_choose_solvers_are_free(tmp_path, option):
    if option.startswith("info"):
        assert refusal(load, tmp_path, f"petsc.{option}")
    else:
        assert load(tmp_path, f"petsc.{option}").petsc


# Sizes


SIZES = {
    "body.spacing=1e-12": "more than this PETSc's integers",
    "body.spacing=1e-300": "must be at least 1e-60",
    "body.size=[1e300,1.0,1.0]": "must be at most 1e+60",
    "body.layers={left=1e50}": "rows of cells, too many",
    "body.refine=1e5": "particles",
    "body.refine=1e30": "particles",
    "body.spacing=5.0 body.horizon={length=1e30}": "",
}


def test_sizes_are_checked_before_anything_is_made(tmp_path):
    """In a process of its own, with 8 GiB for everything."""
    (tmp_path / "bar.toml").write_text(BAR)
    code = (
        "import sys, resource\nfrom pdpetsc import case, prediction, census\nfrom pdpetsc.errors import InputError\n"
        "resource.setrlimit(resource.RLIMIT_AS, (2**33, 2**33))\n"
        "for change in sys.argv[1:]:\n"
        "  try:\n"
        "    p = prediction.predict(case.load('bar.toml', change.split(' ')), 1, census.QUICK)\n"
        "    prediction.check_fits(p, 2**34)\n"
        "    print('fits')\n"
        "  except InputError as error: print(error)\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", code, *SIZES], cwd=tmp_path, capture_output=True, text=True, timeout=120,
        env=environment_for_mpirun(),
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    for said, words in zip(run.stdout.splitlines(), SIZES.values(), strict=True):
        assert words in said


def test_lines_have_not_too_many_points(tmp_path):
    assert "100000" in refusal(load, tmp_path, "probe.0.line=[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], 1000000000000]")


def test_case_files_are_small_and_flat(tmp_path):
    assert "more than 262144 bytes" in refusal(load, tmp_path, text=BAR + "#" * 2**18)
    assert "nested too deeply" in refusal(load, tmp_path, text=BAR + "\n[petsc]\n" + ".".join(["a"] * 30) + "= 1")
    assert "40 parts" in refusal(load, tmp_path, text=".".join(["a"] * 60_000) + "= 1")
    assert "40 parts" in refusal(load, tmp_path, text="[" + ' . "a b"' * 60 + "]")
    assert load(tmp_path, text=BAR + "\n# " + "e.g. a.b.c, " * 60)


# What is said and written


def test_nothing_is_said_that_a_terminal_would_obey(tmp_path):
    assert load(tmp_path, 'title="\\u001b]0;owned\\u0007 bar"').title == "?]0;owned? bar"
    assert "\x1b" not in refusal(load, tmp_path, 'sets."\\u001b[2J"=1')
    assert "\x1b" not in load(tmp_path, name="\x1b[31m.toml").path
    assert "null character" in refusal(load, tmp_path, 'title="a\\u0000b"')


def test_names_that_become_files_stay_in_the_folder(tmp_path):
    assert "no name" in refusal(load, tmp_path, name="...toml")
    for name in ("../x", "a/b", "", "a\nb"):
        assert "a name begins with a letter" in refusal(load, tmp_path, f"probe.0.name={json.dumps(name)}")
    with pytest.raises(InputError, match="there is no"):
        case.load(f"{tmp_path / 'bar.toml'}:../../x")


def result(tmp_path) -> Path:
    directory = tmp_path / "result"
    directory.mkdir()
    (directory / "summary.json").write_text(json.dumps(SUMMARY))
    with h5py.File(directory / "fields.h5", "w") as file:
        write_fields(file, True)
    with h5py.File(directory / "checkpoint.h5", "w") as file:
        write_checkpoint(file, True)
    return directory


def test_links_in_a_result_are_not_written_through(tmp_path):
    directory = result(tmp_path)
    trust.check_no_links(directory)
    for name in ("history.csv", "u-x-step3.png"):
        (directory / name).symlink_to(tmp_path / "precious")
        assert f"{name}: is a link" in refusal(trust.check_no_links, directory)
        (directory / name).unlink()


def test_results_are_believed_when_they_are_ours(tmp_path):
    directory = result(tmp_path)
    trust.check_checkpoint(directory / CHECKPOINT)
    trust.check_fields(directory / HDF5)
    assert tables.read_summary(directory)["dim"] == 2


def test_a_link_to_another_file_is_refused(tmp_path):
    directory = result(tmp_path)
    with h5py.File(directory / "fields.h5", "a") as file:
        del file["00001/u"]
        file["00001/u"] = h5py.ExternalLink(str(directory / "checkpoint.h5"), "/u")
    assert "a link to somewhere else" in refusal(trust.check_fields, directory / HDF5)


def test_fields_beyond_the_end_of_a_file_are_refused(tmp_path):
    directory = result(tmp_path)
    with h5py.File(directory / HDF5, "a") as file:
        end = max(file[name].id.get_offset() for name in ("position", "00001/u", "00002/u"))
    content = (directory / HDF5).read_bytes()
    (directory / HDF5).write_bytes(content[: end + 8])
    assert "fields.h5: is " in refusal(trust.check_fields, directory / HDF5)


@pytest.mark.parametrize("kind", ["external", "compressed", "virtual", "text", "shape", "nan", "ids", "face"])
def test_a_checkpoint_of_another_kind_is_refused(tmp_path, kind):
    directory = result(tmp_path)
    with h5py.File(directory / "checkpoint.h5", "a") as file:
        if kind in ("external", "compressed", "virtual", "text", "shape"):
            del file["u"]
        if kind == "external":
            file.create_dataset("u", (9, 2), "f8", external=[("/etc/passwd", 0, 144)])
        elif kind == "compressed":
            file.create_dataset("u", (10**12, 2), "f8", chunks=(1000, 2), compression="gzip")
        elif kind == "virtual":
            layout = h5py.VirtualLayout((9, 2), "f8")
            layout[:] = h5py.VirtualSource("fields.h5", "position", (9, 3))[:, :2]
            file.create_virtual_dataset("u", layout)
        elif kind == "text":
            file["u"] = "text"
        elif kind == "shape":
            file["u"] = np.zeros((8, 2))
        elif kind == "nan":
            file["u"][3] = np.nan
        elif kind == "ids":
            file["damaged/broken_bonds"][0, 0] = 9
        elif kind == "face":
            file["facets/face"][0] = 77
    assert "checkpoint.h5: is no checkpoint" in refusal(trust.check_checkpoint, directory / CHECKPOINT)


@pytest.mark.parametrize(
    "change",
    [
        {"rows": []}, {"rows": [{"step": 1}]}, {"case": {}}, {"case": {"name": "x"}}, {"time_steps": [{"end": 1.0}]},
        {"refinements": 3}, {"unsolved": "yes"},
    ],
)  # fmt: skip
def test_a_description_of_another_kind_is_refused(change):
    from fuzzing import description

    kept.check_description(description())
    with pytest.raises(kept.Wrong):
        kept.check_description(description() | change)


@pytest.mark.parametrize(
    "state", [{}, [], {"time": 1.0, "step": -1}, {"time": "x", "step": 1}, {"time": 0.0, "step": 1, "u": 2.0},
              {"time": 0.0, "step": 1, "step_size": -1.0}, {"time": float("nan"), "step": 1}],
)  # fmt: skip
def test_a_state_of_another_kind_is_refused(state):
    with pytest.raises(kept.Wrong):
        kept.check_state(state, {"time", "step", "step_size"})


def test_deep_json_is_refused():
    for text in ("[" * 60 + "]" * 60, "[" * 10**6):
        with pytest.raises(kept.Wrong):
            kept.parsed(text)


@pytest.mark.parametrize(
    "change",
    [
        ("case.toml", 'body = 3\nload = "x"\n'), ("case.toml", "[output]\ncurve = 5\n"),
        ("case.toml", ".".join(["a"] * 60) + " = 1"), ("history.csv", "step,time\0\n1,2\n"),
        ("summary.json", json.dumps(SUMMARY | {"choices": 3})), ("summary.json", json.dumps(SUMMARY | {"expect": [1]})),
    ],
)  # fmt: skip
def test_reports_of_damaged_results_are_made_or_refused(tmp_path, change):
    directory, (name, text) = result(tmp_path), change
    (directory / "case.toml").write_text("title = 'x'\n")
    if name == "history.csv":
        (directory / "summary.json").unlink()
    (directory / name).write_text(text)
    try:
        write_report(directory, "not here")
    except InputError as error:
        assert str(directory) in str(error)


def test_curves_and_pictures_of_damaged_results_are_refused(tmp_path):
    directory = result(tmp_path)
    (directory / "history.csv").write_text("step,time\n1,0.5\n")
    (directory / "case.toml").write_text("output = 3\n")
    assert "case.toml, history.csv or summary.json is damaged" in refusal(pictures.plot, directory, View("u"), curve=[])
    (directory / "broken_bonds.csv").write_text("step\nx\n")
    assert "broken_bonds.csv: is damaged" in refusal(pictures.plot, directory, View("u"))
    (directory / "fields.h5").write_bytes(b"nothing")
    assert "fields.h5: is damaged" in refusal(pictures.plot, directory, View("u"))


# Meshes


def test_entities_of_xml_do_not_grow(tmp_path):
    path = tmp_path / "bomb.vtu"
    entities = "".join(f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, 12))
    path.write_text(f'<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a0 "x">{entities}]><VTKFile>&a11;</VTKFile>')
    assert "is not a mesh that can be read" in refusal(surface_of_mesh, str(path), 3, None)


def test_files_that_entities_name_are_not_read(tmp_path):
    (tmp_path / "secret").write_text("secret")
    path = tmp_path / "other.vtu"
    path.write_text(
        f'<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a SYSTEM "file://{tmp_path}/secret">]><VTKFile>&a;</VTKFile>'
    )
    assert "secret" not in refusal(surface_of_mesh, str(path), 3, None).replace(str(tmp_path), "")


def test_a_mesh_that_does_not_end_is_ended(tmp_path, monkeypatch):
    monkeypatch.setattr(apart, "SECONDS", 2.0)
    script, path = tmp_path / "script.py", tmp_path / "mesh.vtk"
    path.write_text("")
    text = Path(meshfile.__file__).read_text()
    script.write_text(text.replace("mesh = meshio.read(path)", "while True: pass"))
    assert "is damaged: reading it " in refusal(apart.read_apart, script, path)
    script.write_text("import os; os.abort()")
    assert "crash" in refusal(apart.read_apart, script, path)
    script.write_text(text.replace("mesh = meshio.read(path)", "np.ones(10**12)"))
    assert "takes all memory" in refusal(apart.read_apart, script, path)


def test_modules_beside_a_mesh_are_not_run(tmp_path, monkeypatch):
    for name in ("meshio", "numpy", "json"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit(5)")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mesh.vtk").write_text("nothing")
    assert "is not a mesh that can be read" in refusal(surface_of_mesh, "mesh.vtk", 3, None)


def test_no_pickle_is_loaded(tmp_path):
    archive = tmp_path / "x.npz"
    np.savez(archive, np.array([{}], object))
    with pytest.raises(ValueError, match="pickle"):
        meshfile.unpacked(archive.read_bytes())


def test_the_checks_of_a_file_run_alone(tmp_path):
    """Without the package, as the child does."""
    directory = result(tmp_path)
    command = [sys.executable, "-P", hdf5_check.__file__, "20", str(2**32), str(directory / "fields.h5"), "fields"]
    assert subprocess.run(command, cwd=tmp_path, capture_output=True).returncode == 0


def test_options_in_a_folder_are_not_read(tmp_path, run_pdpetsc):
    """PETSc would read petscrc and .petscrc where it is started."""
    for name in ("petscrc", ".petscrc"):
        (tmp_path / name).write_text("-log_view :seen.txt\n")
    assert run_pdpetsc(None, "check", cwd=tmp_path).returncode == 0
    assert not (tmp_path / "seen.txt").exists()
