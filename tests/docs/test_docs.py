"""The documents say what the code does: examples run, links lead somewhere, nothing is left out."""

from __future__ import annotations

import importlib
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from pntegrity.cli import COMMANDS
from pntegrity.config import make_config
from pntegrity.monitors import discover
from pntegrity.protocols import Monitor
from pntegrity.simulate.linear import draw, gains, spp_model

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
    (text,) = blocks(ROOT / "docs" / "formats" / "config.md", "toml")
    config = make_config(tomllib.loads(text))
    assert config.noise_model().factor("glr") == 1.2
    assert {m.name: m for m in config.build_monitors()}["aime"].window == 10


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
