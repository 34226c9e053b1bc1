"""The worked examples of the developers' page do what they say."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from models import sample
from pydantic import ValidationError

from pdpetsc.case import Case
from pdpetsc.materials.base import Material
from pdpetsc.schema.materials import material_table
from pdpetsc.schema.values import Setting

TESTS = Path(__file__).parents[1]
PAGE = TESTS.parent / "docs" / "developers.md"


@pytest.fixture
def fibre():
    """The model of the page, in the table while a test runs."""
    (code,) = (
        block for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S) if "FibreSheet(Ord" in block
    )
    assert len(code.splitlines()) < 60
    module: dict = {}
    exec(compile(code, "fibre.py", "exec"), module)
    yield module["FibreSheet"]
    del Material.models["fibre"]


def test_the_row_goes_through_the_tests_of_the_table(tmp_path):
    """One file and one row: the page's, put where the tests of models find them."""
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S)
    (code,) = (block for block in blocks if "FibreSheet(Ord" in block)
    (row,) = (block for block in blocks if block.startswith('Model("fibre"'))
    table = (TESTS / "models.py").read_text().replace("\nMODELS = [\n", f"\nMODELS = [\n    {row.strip()}\n")
    (tmp_path / "fibre.py").write_text(code)
    (tmp_path / "models.py").write_text(f"from fibre import FibreSheet\n{table}")
    shutil.copy(TESTS / "materials" / "test_models.py", tmp_path)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (tmp_path, TESTS, TESTS.parent)))}
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "--rootdir",
        str(tmp_path),
        "-k",
        "fibre",
    ]
    run = subprocess.run([*command, "test_models.py"], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout
    assert int(re.search(r"(\d+) passed", run.stdout)[1]) > 15


def test_it_is_stiffer_along_its_fibres(fibre):
    body = sample(2)
    along, across = np.outer([1, 0], [1, 0]), np.outer([0, 1], [0, 1])
    material = fibre(body.neighbourhood(), 1.0, 10.0, 0.0)
    energies = [material.energy(1e-3 * body.X @ strain).sum() for strain in (along, across)]
    assert energies[0] > 3 * energies[1]


def test_its_keys_are_those_of_the_case_file(fibre):
    table = material_table(fibre)
    setting = Setting(2, ("all",), ())
    keys = table.model_validate({"model": "fibre", "E": 1.0, "stiffening": 2.0}, context=setting)
    assert fibre.from_case(keys, sample(2).neighbourhood()).choices()["fibres"]
    for wrong in ({"E": -1.0}, {"stiffening": "much"}, {"nu": 0.3}):
        with pytest.raises(ValidationError):
            table.model_validate({"model": "fibre", "E": 1.0, "stiffening": 2.0} | wrong, context=setting)
    with pytest.raises(ValidationError, match="two dimensions, not 3"):
        table.model_validate({"model": "fibre", "E": 1.0, "stiffening": 2.0}, context=Setting(3, ("all",), ()))


def test_snippets_of_the_case_file_page_are_valid():
    """Each TOML block, completed to a whole case."""
    page = (TESTS.parent / "docs" / "case-file.md").read_text()
    whole, *parts = re.findall(r"```toml\n(.*?)```", page, re.S)
    setting = tomllib.loads(whole)
    for part in [whole, *parts]:
        given = tomllib.loads(part) if "[" in part.split("=")[0] or "units" in part else {"body": tomllib.loads(part)}
        document = {key: value for key, value in setting.items() if key not in given} | given
        if "mesh" not in document["body"]:
            document["body"] = setting["body"] | document["body"]
        names = set(re.findall(r'(?:set|where|near) = "(\w+)"', part)) - {"all"}
        document["sets"] = dict.fromkeys(names | {"clamp", "end"}, "X < 1") | document.get("sets", {})
        variants = document.pop("variant", {})
        document["probe"] = document.get("probe", []) + [
            {"name": "tip", "field": "u", "component": "x", "at": [1.0, 1.0]}
        ]
        document["probe"] = list({probe["name"]: probe for probe in document["probe"]}.values())
        if "expect" in document:
            names = {e["value"].split(".")[1] for e in document["expect"]} - {p["name"] for p in document["probe"]}
            document["probe"] += [{"name": n, "field": "u", "component": "x", "at": [1.0, 1.0]} for n in names]
        Case.from_document(document | {"material": document["material"]}, "page", None, "page", False)
        assert all(isinstance(variant, dict) for variant in variants.values())


def test_every_key_of_the_schema_is_explained():
    """scripts/reference finds a meaning for each on the page of the case file."""
    command = [sys.executable, str(TESTS.parent / "scripts" / "reference")]
    run = subprocess.run(command, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    for row in (
        "| `spacing` | number > 0 | required |",
        '### model = "correspondence"',
        "| `steps` | whole number ≥ 1 | 10 |",
    ):
        assert row in run.stdout


def test_links_between_pages_lead_somewhere():
    """Files and headings, as they are called where the pages are read as they stand."""
    root = TESTS.parent
    pages = [root / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
    pages += [path for path in root.glob("docs/**/*.md")]
    anchors = {page.resolve(): _anchors(page.read_text()) for page in pages}
    for page in pages:
        for target, anchor in re.findall(r"\]\((?!https?:)([^)#\s]*)(?:#([^)\s]*))?\)", page.read_text()):
            path = (page.parent / target).resolve() if target else page.resolve()
            assert path.exists(), f"{page}: {target}"
            assert not anchor or anchor in anchors[path], f"{page}: {target}#{anchor}"


def _anchors(text):
    """The names of its headings: small letters, digits, - and _, blanks as -."""
    titles = re.findall(r"^#+ (.*)$", re.sub(r"```.*?```", "", text, flags=re.S), re.M)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def test_every_page_is_in_the_site():
    """What `scripts/docs` would refuse, where it is not installed; reference.md is made by it."""
    docs = TESTS.parent / "docs"
    listed = set(re.findall(r"docs/([\w/-]+\.md)", (docs / "mkdocs.yml").read_text().partition("nav:")[2]))
    assert listed == {str(path.relative_to(docs)) for path in docs.rglob("*.md")} | {"reference.md"}
