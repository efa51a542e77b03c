"""The documents say what the code does: examples run, links lead somewhere, nothing is left out."""

from __future__ import annotations

import importlib
import re
import tomllib
from dataclasses import fields
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest

from pntegrity.cli import COMMANDS, cli
from pntegrity.config import RunConfig, make_config
from pntegrity.monitors import discover
from pntegrity.protocols import Monitor
from pntegrity.simulate.linear import draw, gains, spp_model
from pntegrity.vehicle import types

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / n for n in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")] + sorted(
    (ROOT / "docs").rglob("*.md")
)
PAGES = [p for p in PAGES if "_build" not in p.parts]


def blocks(page: Path, language: str) -> list[str]:
    """Return the fenced blocks of a language."""
    return re.findall(
        rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_to_files(page: Path) -> None:
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    targets = [t.partition("#")[0] for t in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in t]
    missing = [t for t in targets if t and not (page.parent / t).exists()]
    assert not missing


def test_the_own_filter_of_the_readme_is_the_tested_example() -> None:
    example = (ROOT / "docs" / "examples" / "own_filter.py").read_text(encoding="utf-8")
    heart = re.search(r"^def watched.*?(?=\n\n\n)", example, re.MULTILINE | re.DOTALL)
    assert heart is not None
    assert any(heart[0] in block for block in blocks(ROOT / "README.md", "python"))


def test_every_monitor_has_a_page_and_every_command_a_section() -> None:
    pages = {p.stem for p in (ROOT / "docs" / "monitors").glob("*.md")}
    assert set(discover()) <= pages
    sections = re.findall(
        r"^## `([\w-]+)`", (ROOT / "docs" / "cli.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert set(COMMANDS) == set(sections)


def test_the_example_configuration_is_one() -> None:
    text, vehicle = blocks(ROOT / "docs" / "formats" / "config.md", "toml")
    config = make_config(tomllib.loads(text))
    assert config.noise_model().factor("glr") == 1.2
    assert {m.name: m for m in config.build_monitors()}["aime"].window == 10
    ism = make_config(tomllib.loads(vehicle)).ism_model()
    assert (dict(ism.sources), ism.hal_m) == ({"lbl": 1e-4, "lbl.*": 1e-5}, 10.0)


def test_every_field_of_the_configuration_is_on_its_page() -> None:
    page = (ROOT / "docs" / "formats" / "config.md").read_text(encoding="utf-8")
    missing = [name for name in RunConfig.model_fields if not re.search(rf"\b{name}\b", page)]
    assert not missing


def test_every_option_is_on_the_page_of_the_command_line() -> None:
    page = (ROOT / "docs" / "cli.md").read_text(encoding="utf-8")
    options = {
        word
        for name in COMMANDS
        for p in cli.get_command(click.Context(cli), name).params
        for word in (*p.opts, *p.secondary_opts)
        if word.startswith("--")
    }
    assert len(options) > 50
    assert not {word for word in options if not re.search(rf"{word}(?![\w-])", page)}


def test_every_field_of_a_source_is_on_a_page() -> None:
    pages = "".join(p.read_text(encoding="utf-8") for p in PAGES)
    taken = {"klobuchar"}  # of the navigation file
    for kind, cls in types().items():
        missing = {f.name for f in fields(cls)} - set(re.findall(r"\w+", pages)) - taken
        assert not missing, kind


def test_every_campaign_is_on_the_page_of_the_command_line() -> None:
    page = (ROOT / "docs" / "cli.md").read_text(encoding="utf-8")
    command = cli.get_command(click.Context(cli), "evidence")
    (names,) = (p.type.choices for p in command.params if isinstance(p, click.Argument))
    assert not [name for name in names if f"`{name}`" not in page and name != "all"]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_to_headings(page: Path) -> None:
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+\.md#[^)\s]+|#[^)\s]+)\)", text):
        file, _, anchor = target.partition("#")
        assert "://" in target or anchor in anchors(page.parent / file if file else page), target


def anchors(page: Path) -> set[str]:
    """Return what links into a page may name: its headings as GitHub and MyST write them, and its targets."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    plain = [re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", h) for h in re.findall(r"^#+ (.*)$", text, re.MULTILINE)]
    slugs = {re.sub(r"[^\w\- ]", "", h.strip().lower()).replace(" ", "-") for h in plain}
    return slugs | set(re.findall(r"^\(([\w-]+)\)=$", text, re.MULTILINE))


def test_tables_in_docstrings_have_room_between_their_columns() -> None:
    # GIVEN every simple table that pages show: one that is not well formed ends `make docs`
    for path in sorted((ROOT / "src").rglob("*.py")):
        lines = path.read_text(encoding="utf-8").splitlines()
        rules = [i for i, line in enumerate(lines) if re.fullmatch(r" *=+ =+", line)]
        for begin, end in zip(rules[1::3], rules[2::3], strict=True):
            margin = lines[begin].index(" ", lines[begin].index("="))
            # THEN no text stands in the margin between the two columns
            bad = [line for line in lines[begin + 1 : end] if line[margin : margin + 1] not in ("", " ")]
            assert not bad, path


def test_the_page_on_python_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # GIVEN the folders that the page asks for
    monkeypatch.chdir(tmp_path)
    for command in (["demo"], ["simulate-vessel", "--out", "ship", "--seconds", "60"]):
        cli.main(command, standalone_mode=False)
    # WHEN its blocks run one after the other
    names: dict[str, Any] = {}
    for block in blocks(ROOT / "docs" / "python.md", "python"):
        exec(block, names)
    # THEN they show what they say
    assert names["trusted"].height + names["doubtful"].height == names["summary"]["epochs"] == 300
    assert {"g07", "e19"} <= {k.lower() for k in names["exclusions"]["key"]}
    assert [e.group for o in names["result"].outcomes for e in o.exclusions] == ["depth"]
    assert (tmp_path / "again" / "report.html").exists()
    assert names["later"].checkpoint.state.t_ns == names["loaded"].epochs[-1].t_ns


def test_the_example_monitor_keeps_its_false_alarm_rate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # GIVEN the monitor of the page
    page = blocks(ROOT / "docs" / "add-a-monitor.md", "python")
    (source,) = (b for b in page if b.startswith('"""LARGEST'))
    (tmp_path / "largest.py").write_text(source, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monitor = importlib.import_module("largest").Largest(p_fa=0.01)
    assert isinstance(monitor, Monitor)
    # WHEN it looks at clean innovations
    updates = gains(spp_model(), 50)
    rng, alarms, tests = np.random.default_rng(5), 0, 0
    for _ in range(200):
        memory = monitor.start()
        for u in draw(updates, rng.standard_normal((50, len(updates[0].keys)))):
            verdict, memory = monitor.step(memory, u)
            alarms, tests = alarms + (verdict.status == "alert"), tests + (verdict.status != "unavailable")
    # THEN it alarms as often as it says
    assert abs(alarms / tests - 0.01) < 4.0 * np.sqrt(0.01 / tests)
