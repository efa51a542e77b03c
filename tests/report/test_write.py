import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from io import StringIO

import numpy as np
import polars as pl
import pytest
from rich.console import Console

from pntegrity.errors import InputError
from pntegrity.formats.update_record import read_record
from pntegrity.report.facts import RunFacts
from pntegrity.report.figures import array, frame, packed
from pntegrity.report.html import page, write_html
from pntegrity.report.summary import summary
from pntegrity.report.tables import solution
from pntegrity.report.terminal import verdict_table
from pntegrity.report.write import entries, write_results

EVIL = "</script><script>alert('x')</script><img src=http://evil.example/a.png onerror=alert(1)>"


class Page(HTMLParser):
    """Collects the tags, links and embedded data of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.text = ""
        self.data = ""
        self._data = False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [v or "" for k, v in attrs if k in ("src", "href")]
        self._data = dict(attrs).get("type") == "application/json"

    def handle_endtag(self, tag):
        self._data = False

    def handle_data(self, data):
        if self._data:
            self.data += data
        else:
            self.text += data


def make(outcomes, facts) -> str:
    table = solution(outcomes, facts)
    return page(outcomes, facts, summary(outcomes, facts, table), table)


@pytest.fixture(scope="module")
def report(faulty) -> str:
    facts = RunFacts(
        estimator="spp_kf",
        noise_name=EVIL,
        notes=(EVIL,),
        faults=(EVIL,),
        blind_spots=(EVIL,),
        config={EVIL: EVIL},
    )
    return make(faulty, facts)


def test_all_files_are_written_and_agree(faulty, facts, tmp_path):
    paths = write_results(tmp_path / "a" / "b", faulty, facts)
    assert sorted(p.name for p in (tmp_path / "a" / "b").iterdir()) == sorted(p.name for p in paths.values())
    assert len(pl.read_parquet(paths["solution"])) == len(faulty)
    assert len(pl.read_parquet(paths["verdicts"]).filter(pl.col("final"))) == 4 * len(faulty)
    assert pl.read_csv(paths["exclusions"])["key"].to_list() == ["G05", "E12"]
    assert json.loads(paths["summary"].read_text())["epochs"] == len(faulty)
    assert (
        len(read_record(paths["updates"]))
        == len(entries(faulty))
        == len(faulty) + sum(o.rewound for o in faulty)
    )
    assert read_record(paths["updates"]).about["estimator"] == "spp_kf"


@pytest.mark.parametrize("n", [0, 1, 25])
def test_partial_and_empty_runs_are_written(faulty, facts, tmp_path, n):
    paths = write_results(tmp_path, faulty[:n], replace(facts, interrupted=True))
    assert len(pl.read_parquet(paths["solution"])) == n
    assert len(read_record(paths["updates"])) == len(entries(faulty[:n]))
    assert "interrupted" in paths["report"].read_text()


def test_results_replace_those_of_an_earlier_run(faulty, clean, facts, tmp_path):
    write_results(tmp_path, faulty, facts)
    paths = write_results(tmp_path, clean, facts)
    assert json.loads(paths["summary"].read_text())["epochs"] == len(clean)
    assert len(list(tmp_path.iterdir())) == 6


def test_a_folder_that_cannot_be_made_is_said(faulty, facts, tmp_path):
    (tmp_path / "file").write_text("")
    for where in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(InputError, match="cannot be made"):
            write_results(where, faulty[:2], facts)


def test_a_file_that_cannot_be_replaced_is_said(clean, facts, tmp_path):
    (tmp_path / "report.html").mkdir()
    with pytest.raises(InputError, match=r"report\.html"):
        write_html(tmp_path / "report.html", clean, facts)
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


def test_nothing_from_outside_is_loaded_and_no_text_becomes_markup(report):
    seen = Page(report)
    assert "img" not in seen.tags
    assert seen.links == []
    assert seen.tags.count("script") == 3
    assert "default-src 'none'" in report
    assert EVIL in seen.text


def test_the_embedded_data_is_json_with_every_epoch(report, faulty):
    data = json.loads(Page(report).data)
    names = [f["name"] for f in data["figures"]]
    assert names == ["status", "monitors", "timeline", "residuals", "used", "position", "sky"]
    assert all(f"id='fig-{n}'" in report for n in names)
    f = frame(faulty)
    assert np.array_equal(f.at[f.at >= 0], np.arange(len(faulty)))
    assert np.all(np.diff(f.x_ms) > 0.0)
    assert (f.at < 0).sum() == 2  # one gap


def test_every_colour_and_array_that_a_figure_names_exists(report):
    styles = set(re.findall(r"(--[\w-]+):", report[: report.index("</style>")]))
    for figure in json.loads(Page(report).data)["figures"]:
        named = set(re.findall(r'"(--[\w-]+)"', json.dumps(figure)))
        assert named <= styles
        assert set(re.findall(r'"(\$\w+)"', json.dumps(figure))) <= {"$t"}


def test_the_file_stays_small(report):
    assert len(report.encode()) < 6e6


def test_the_report_tells_the_verdict_first(unresolved, clean, facts):
    assert "Do not trust" in make(unresolved, facts)
    assert "No alarm in" in make(clean, facts)
    assert "No truth" in make(clean, replace(facts, truth_m=None))


def test_an_empty_run_has_a_report_without_figures(facts):
    text = make([], facts)
    assert "No epoch was processed" in text
    assert "Plotly" not in text


def test_packed_numbers_come_back():
    values = np.array([[0.0, 1.234, np.nan], [-4.0, 1e9, -1e9]])
    import base64

    p = packed(values, 0.01)
    raw = np.frombuffer(base64.b64decode(p["packed"]), dtype="<i2").reshape(-1, p["columns"])
    assert raw[0].tolist() == [0, 123, -32768]
    assert raw[1].tolist() == [-400, 32767, -32767]
    exact = array(np.array([1.5e12]), exact=True)
    assert np.frombuffer(base64.b64decode(exact["bdata"]))[0] == 1.5e12


@pytest.mark.parametrize("run", ["faulty", "unresolved", "clean"])
def test_the_terminal_shows_each_monitor(run, facts, request):
    outcomes = request.getfixturevalue(run)
    out = StringIO()
    Console(file=out, width=120).print(verdict_table(outcomes, facts))
    assert all(m in out.getvalue() for m in ("rctm", "srctm", "aime", "glr", "position    RMS", "06:15:00"))


def test_the_terminal_shows_markup_as_it_is(facts):
    out = StringIO()
    Console(file=out, width=80).print(verdict_table([], facts))
    assert "No epoch was processed" in out.getvalue()
