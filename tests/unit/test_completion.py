"""Completion scripts, run by the shells themselves."""

import shutil
import subprocess

import pytest

from pdpetsc import completion
from pdpetsc.commands import COMMANDS, OPTIONS, SHELLS

BASH = """
source ./script
COMP_LINE='{line}'; COMP_POINT=${{#COMP_LINE}}
_pdpetsc
printf '%s\\n' "${{COMPREPLY[@]}}"
"""
ZSH = """
compdef() {{ }}
compadd() {{ shift; print -l -- ${{(M)@:#$typed*}} }}
_files() {{ if [[ "$1" == -g ]]; then print -l -- $typed*.toml(N); else print -l -- $typed*(/N); fi }}
source ./script
words=({words}); CURRENT=$#words; typed=$words[-1]
[[ '{line}' == *' ' ]] && {{ words+=(''); CURRENT=$#words; typed='' }}
_pdpetsc
"""
FISH = "source ./script; complete -C '{line}'"


@pytest.fixture
def complete(tmp_path):
    """`complete(shell, line)`: what the shell offers at the end of a line, in a folder with a case and a result."""
    (tmp_path / "mine.toml").touch()
    (tmp_path / "notes.txt").touch()
    (tmp_path / "results").mkdir()

    def offered(shell, line):
        if shutil.which(shell) is None:
            pytest.skip(f"no {shell} here")
        (tmp_path / "script").write_text(completion.script(shell))
        text = {"bash": BASH, "zsh": ZSH, "fish": FISH}[shell].format(line=line, words=line)
        run = subprocess.run([shell, "-c", text], cwd=tmp_path, capture_output=True, text=True, timeout=20)
        assert run.stderr == ""
        return {said.partition("\t")[0].rstrip("/") for said in run.stdout.splitlines()} - {""}

    return offered


@pytest.mark.parametrize("shell", SHELLS)
@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("pdpetsc ch", {"check"}),
        ("pdpetsc check clamped_b", {"clamped_beam"}),
        ("pdpetsc list mod", {"models"}),
        ("pdpetsc completion f", {"fish"}),
        ("pdpetsc run mi", {"mine.toml"}),
        ("pdpetsc mi", {"mine.toml"}),
        ("pdpetsc plot re", {"results"}),
        ("pdpetsc check mine.toml --ra", {"--ranks"}),
        ("pdpetsc new --model bo", {"bond"}),
        ("pdpetsc new --model bond --kind ", set(OPTIONS["--kind"].choices)),
        ("pdpetsc schema x", set()),
    ],
)
def test_what_is_offered(shell, line, offered, complete):
    found = complete(shell, line)
    if line.endswith("clamped_b"):  # and its variants: bash is offered what follows the colon when it is there
        assert "clamped_beam" in found and "clamped_beam:rows3_d2" in found
    else:
        assert found == offered


@pytest.mark.parametrize("shell", SHELLS)
def test_every_command_is_offered(shell, complete):
    assert {*COMMANDS} <= complete(shell, "pdpetsc ")


def test_bash_completes_variants_after_the_colon(complete):
    """To bash, a colon begins another word."""
    assert complete("bash", "pdpetsc clamped_beam:rows5_") == {"rows5_d1", "rows5_d2", "rows5_d3"}


@pytest.mark.parametrize("shell", SHELLS)
@pytest.mark.parametrize("command", COMMANDS)
def test_options_are_those_of_the_command(shell, command, complete):
    found = complete(shell, f"pdpetsc {command} --")
    assert found - {"--help", "--version"} == {name for name, about in OPTIONS.items() if command in about.commands}
