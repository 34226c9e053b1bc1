"""The report of a result, from results that are made by hand."""

import json
import re
from html.parser import HTMLParser

import h5py
import pytest
from handmade import made

from pdpetsc.errors import InputError
from pdpetsc.io import rendering, report, tables
from pdpetsc.io.report import number, write_report

EVIL = "<script>alert(1)</script>\"><img src='http://example.org/x' onerror=alert(1)> & {{ 7 * 7 }}"

CASE = {
    "title": "A block",
    "units": {"length": "mm", "force": "N"},
    "body": {"size": [8.0, 6.0], "spacing": 1.0, "horizon": 2.015},
    "material": {"steel": {"model": "correspondence", "E": 210e3, "stabilisation": {"kind": "none"}}},
    "damage": {"steel": {"criterion": "critical_stretch", "G_c": 0.1}},
    "load": [
        {"kind": "displacement", "set": "left", "component": "all", "value": 0.0},
        {"kind": "pressure", "surface": "top", "value": "5 * t"},
    ],
    "probe": [
        {"name": "pull", "field": "u", "component": "x", "set": "right", "reduce": "mean"},
        {"name": "line", "field": "stress", "line": [[0, 0], [1, 0], 12]},
        {"name": "J", "field": "J", "tip": [1.0, 2.0]},
    ],
    "output": {"picture": "damage", "curve": {"x": "pull", "y": "time"}},
}
VOID = {"meta", "img", "br", "link"}


class Page(HTMLParser):
    """The tags of a page, checked to be closed in order, and its text."""

    def __init__(self, text: str):
        super().__init__()
        self.open, self.tags, self.attributes, self.words = [], [], [], []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.attributes += attributes
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag, f"</{tag}> at {self.getpos()}"

    def handle_data(self, data):
        if self.open[-1:] != ["style"]:
            self.words.append(data)

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", " ".join(self.words))


@pytest.fixture(autouse=True)
def quick_pictures(monkeypatch):
    monkeypatch.setattr(rendering, "find_spec", lambda name: None)
    monkeypatch.setattr(report, "DPI", 40)


@pytest.fixture
def without_pictures(monkeypatch):
    monkeypatch.setattr(report, "_pictures", lambda *of: ([], []))


def result(directory, dim=2, case=CASE, mode="newton", **changes):
    """A result directory, whole."""
    summary = made(directory, dim, mode=mode) | {
        "title": case["title"], "case": "block", "variant": "fine", "status": "converged", "converged": True,
        "version": "0.1.0", "petsc_version": "3.18.5", "particles": 48, "bonds": 400, "ranks": 2, "spacing": 1.0,
        "family_size": {"min": 5, "max": 12}, "peak_memory_mb": 123.4,
        "probes": {"pull": 0.1, "line": [[float(k)] * 9 for k in range(12)], "J": 2.5},
        "energies": {"stored": 1.5}, "balance": {"force": 1e-17, "moment": 2e-17},
        "fracture": {"broken_bonds": 4, "crack_area": 2.0, "failure_time": None}, "timings": {"total": 3.25},
        "unused_options": ["pc_tpye"],
        "expect": [
            {"name": "probes.pull", "value": 0.1, "expected": 0.1, "tolerance": 0.01, "met": True, "source": "a book"},
            {"name": "probes.J", "value": 2.5, "expected": "< 2", "tolerance": 0.0, "met": False, "source": "another"},
        ],
    } | changes  # fmt: skip
    for row in summary["steps"]:
        row |= {"newton_iterations": 3, "relative_residual": 1e-12, "broken_bonds": 4, "seconds": 0.1}
    tables.write_case(directory, case, "0.1.0, block.toml")
    rows = [{k: v for k, v in row.items() if k != "residual_norms"} for row in summary["steps"]]
    tables.write_history(directory / "history.csv", [row | {"probes": {"pull": 0.1 * row["step"]}} for row in rows])
    tables.write_summary(directory / "summary.json", summary)
    return summary


def page_of(directory) -> tuple[Page, str]:
    text = write_report(directory).read_text(encoding="utf-8")
    return Page(text), text


def test_it_says_all_there_is(tmp_path, without_pictures):
    result(tmp_path)
    page, _ = page_of(tmp_path)
    for words in (
        "The run converged.", "48 particles in 2D of steel (correspondence); 2 steps, Newton's method on 2 ranks.",
        "size [mm] 8 x 6", "2.015 times the spacing", "bonds of a family, mean 8.33333", "least and most 5 and 12",
        "E [MPa] 210000", "kind = none", "failure: G_c [N/mm] 0.1", "pressure top 5 * t MPa", "displacement left all",
        "pull mean displacement x over the set right 0.1 mm", "J J-integral at [1, 2] 2.5 N/mm", "(12 in all)] MPa",
        "1 of 2 met.", "met probes.pull 0.1 0.1 0.01 a book", "missed probes.J 2.5 < 2 another", "stored [mJ] 1.5",
        "crack area [mm²] 2", "total 3.25", "nobody used: pc_tpye", "pdpetsc 0.1.0 · PETSc 3.18.5 · at most 123 MB",
        "block:fine", 'criterion = "critical_stretch"',
    ):  # fmt: skip
        assert words in page.text, words
    assert tables.is_result(tmp_path)


def test_a_field_is_shown_once(tmp_path):
    """Stress is seen as von Mises stress, which may be a field of its own."""
    summary = made(tmp_path, 2)
    with h5py.File(tmp_path / "fields.h5", "a") as file:
        for step in ("00001", "00002"):
            file[step]["von_mises"] = file[step]["damage"][...]
    for field in ("von_mises", "damage"):
        document = CASE | {"output": {"picture": field}}
        captions = [shown.caption for shown in report._pictures(tmp_path, document, summary, "")[0]]
        first = {"von_mises": "von Mises stress", "damage": "damage"}[field]
        assert captions[0] == first and sorted(captions) == [
            "convergence of Newton's method", "damage", "displacement |u|", "von Mises stress",
        ]  # fmt: skip


def test_it_stands_alone_and_has_its_pictures(tmp_path):
    result(tmp_path)
    page, text = page_of(tmp_path)
    pictures = [value for name, value in page.attributes if name == "src"]
    captions = re.findall("<figcaption>(.*?)</figcaption>", text)
    assert captions == ["damage", "displacement |u|", "von Mises stress", "time over pull",
                        "convergence of Newton&#39;s method"]  # fmt: skip
    assert len(pictures) == 5 and all(src.startswith("data:image/png;base64,iVBORw0KGgo") for src in pictures)
    alternatives = [value for name, value in page.attributes if name == "alt"]
    assert len(alternatives) == 5 and all(len(words) > 20 for words in alternatives)
    assert not {"script", "link", "iframe", "object", "form", "a"} & set(page.tags)
    assert "http://" not in text and "https://" not in text and "url(" not in text and "@import" not in text
    assert 20_000 < len(text) < 1_000_000
    assert 'name="viewport"' in text and "prefers-color-scheme: dark" in text and '<html lang="en">' in text


def test_nothing_from_a_case_becomes_html(tmp_path):
    """Every text that a stranger may have written, keys too."""
    evil = {
        "title": EVIL, "units": {"length": EVIL, "force": EVIL, "time": EVIL},
        "body": {"size": [8.0, 6.0], "spacing": EVIL, "horizon": {"length": EVIL}},
        "material": {EVIL: {"model": EVIL, EVIL: EVIL, "E": [EVIL]}},
        "damage": {EVIL: {"criterion": EVIL}},
        "load": [{"kind": EVIL, "set": EVIL, "component": EVIL, "value": EVIL}],
        "probe": [{"name": EVIL, "field": EVIL, "component": EVIL, "set": EVIL, "reduce": "mean"}],
        "output": {"curve": {"x": EVIL, "y": "time"}},
    }  # fmt: skip
    result(
        tmp_path, case=evil, units=evil["units"], case_name=EVIL, variant=EVIL, version=EVIL, petsc_version=EVIL,
        status=EVIL, choices={EVIL: {EVIL: EVIL}, "mode": EVIL}, probes={EVIL: EVIL}, energies={EVIL: EVIL},
        fracture={EVIL: EVIL}, balance={EVIL: EVIL}, timings={EVIL: EVIL}, unused_options=[EVIL],
        expect=[{"name": EVIL, "value": EVIL, "expected": EVIL, "tolerance": EVIL, "met": True, "source": EVIL}],
    )  # fmt: skip
    page, text = page_of(tmp_path)
    assert "<script" not in text and "alert(1)" in text and "49" not in re.sub('base64,[^"]*', "", text)
    assert "script" not in page.tags
    assert {name for name, _ in page.attributes} <= {
        "lang", "charset", "name", "content", "http-equiv", "class", "src", "alt", "scope", "open", "aria-label"
    }  # fmt: skip
    assert all(value.startswith("data:image/png;base64,") for name, value in page.attributes if name == "src")


@pytest.mark.parametrize("dim", [1, 3])
def test_other_dimensions(tmp_path, dim):
    case = CASE | {"body": CASE["body"] | {"size": [8.0, 6.0, 5.0][:dim]}}
    result(tmp_path, dim, case)
    page, text = page_of(tmp_path)
    assert f"in {dim}D" in page.text and text.count("<img") == 5


def test_a_motion(tmp_path):
    steps = [{"step": 5 * k, "time": 0.5 * k, "kinetic_energy": 2.0, "imbalance": 1e-3} for k in range(1, 31)]
    result(tmp_path, mode="verlet", steps=steps)
    page, text = page_of(tmp_path)
    assert "velocity Verlet" in page.text and "t [s]" in page.text and "kinetic [mJ]" in page.text
    assert "convergence" not in page.text
    assert "<details><summary>30 steps" in text  # closed: it is long


def test_a_refined_body_and_a_path(tmp_path, without_pictures):
    result(tmp_path, refinements=[{"step": 3, "particles": 60}, {"step": 4, "particles": 90}])
    summary = json.loads((tmp_path / "summary.json").read_text())
    for row in summary["steps"]:
        row |= {"arc_length": 0.25, "particles": 90}
    tables.write_summary(tmp_path / "summary.json", summary)
    page, _ = page_of(tmp_path)
    assert "refined 2 times" in page.text and "arc length [mm]" in page.text


@pytest.mark.parametrize(
    ("status", "words"), [("not_converged", "The run did not converge."), ("interrupted", "The run was interrupted.")]
)
def test_runs_that_failed(tmp_path, without_pictures, status, words):
    result(tmp_path, status=status, converged=False, expect=[])
    page, text = page_of(tmp_path)
    assert words in page.text and f'<span class="bad">{words}' in text and "Expectations" not in page.text


def test_a_run_that_was_killed(tmp_path):
    """Without a summary there are the case, the history and the fields; without those the case is left."""
    result(tmp_path)
    (tmp_path / "summary.json").unlink()
    page, text = page_of(tmp_path)
    assert "The run has not ended." in page.text and "2 steps" in page.text and text.count("<img") == 4
    assert "pull mean displacement x over the set right 0.2 mm" in page.text
    for name in ("history.csv", "fields.h5"):
        (tmp_path / name).unlink()
    page, text = page_of(tmp_path)
    assert "No step was committed." in page.text and "<img" not in text


def test_a_step_that_was_being_written(tmp_path):
    result(tmp_path)
    with h5py.File(tmp_path / "fields.h5", "a") as file:
        del file["00002/u"]
    page, text = page_of(tmp_path)
    assert "Pictures that could not be made: damage: " in page.text and text.count("<img") == 2


def test_a_directory_that_is_no_result(tmp_path):
    with pytest.raises(InputError, match="holds no result of pdpetsc"):
        write_report(tmp_path)


def test_numbers():
    assert [number(v) for v in (0.1 + 0.2, 3, True, None, "x", [1.0, 2])] == ["0.3", "3", "yes", "", "x", "[1, 2]"]
    assert number(list(range(9))) == "[0, 1, 2, 3, 4, 5, ... (9 in all)]"
