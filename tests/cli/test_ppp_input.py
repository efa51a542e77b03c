"""What can be wrong with the input of precise positioning: a line that says what to do, or a result and a
note.
"""

from __future__ import annotations

import gzip
import json
import re

import numpy as np
import polars as pl
import pytest

END = 1800
EPOCHS = 61


class Case:
    """Half an hour of the ESBC log, its products as text, and a way to run them."""

    def __init__(self, shared, folder, call):
        source = shared / "esbc-static-2020177"
        if not source.is_dir():
            pytest.skip("esbc-static-2020177 not in the shared data")
        self.folder, self.call = folder, call
        self.sp3 = sorted(source.glob("*SP3.gz"))
        self.clk_file, self.nav = next(source.glob("*CLK.gz")), next(source.glob("*_MN.rnx.gz"))
        self.antex = shared / "antex/igs14_sats_only.atx.gz"
        text = gzip.decompress(next(source.glob("*_MO.rnx.gz")).read_bytes()).decode("latin-1")
        header, *epochs = text.split("\n>")
        self.header, self.epochs = header + "\n", [f">{e.rstrip()}\n" for e in epochs[:EPOCHS]]
        clocks = gzip.decompress(self.clk_file.read_bytes()).decode().split("\n")
        self.clk = "\n".join(c for c in clocks if not re.match(r"A[RS] \w+ +2020 06 25 0[1-7]", c))

    def obs(self, epochs=None, header=None):
        path = self.folder / "rover.rnx"
        path.write_text(
            (header or self.header) + "".join(self.epochs if epochs is None else epochs), "latin-1"
        )
        return path

    def text(self, name, text):
        path = self.folder / name
        path.write_text(text)
        return path

    def __call__(
        self, *options, epochs=None, header=None, systems="GR", estimator="ppp", monitors="rctm", **files
    ):
        """Run; `files` replace options of that name (None: left out)."""
        out = self.folder / "results"
        given = {"obs": self.obs(epochs, header), "sp3": self.sp3, "clk": [self.text("c.clk", self.clk)],
                 "antex": [self.antex]} | files  # fmt: skip
        words = []
        for name, value in given.items():
            for path in value if isinstance(value, list) else [value] if value else []:
                words += [f"--{name}", path]
        extra = ("--estimator", estimator, "--systems", systems, "--monitors", monitors, "--out", out)
        return Done(self.call("run", *words, *extra, *options), out)


class Done:
    """What a run left."""

    def __init__(self, called, folder):
        self.called, self.folder = called, folder

    @property
    def summary(self):
        assert self.called.code == 0, self.called
        return json.loads((self.folder / "summary.json").read_text())

    @property
    def notes(self):
        return "; ".join(self.summary["notes"])

    @property
    def place(self):
        rows = pl.read_parquet(self.folder / "solution.parquet")
        return rows.select("x_m", "y_m", "z_m").drop_nulls().to_numpy()[-1]

    @property
    def available(self):
        return self.summary["availability"]["ok"]["epochs"]


@pytest.fixture
def esbc(shared, tmp_path, pnt):
    return Case(shared, tmp_path, pnt)


PLAIN: list[Done] = []


@pytest.fixture
def plain(shared, tmp_path_factory, pnt):
    """The log as it is, run once."""
    if not PLAIN:
        PLAIN.append(Case(shared, tmp_path_factory.mktemp("plain"), pnt)())
    return PLAIN[0]


def near(done, plain, metres=0.3):
    return float(np.linalg.norm(done.place - plain.place)) < metres


# --- products that do not fit


def test_the_log_itself(plain):
    assert plain.summary["epochs"] == EPOCHS
    assert plain.available > 40
    assert len(plain.summary["notes"]) < 16


def test_orbits_of_another_day(esbc):
    assert esbc(sp3=esbc.sp3[:1], clk=None).called.refused(
        "rover.rnx", "both a precise orbit and a clock", "2020-06-24", "SP3", "same days"
    )


def test_clocks_of_another_day(esbc):
    other = re.sub(r"^(AS \w\d\d  2020  6) 25", r"\1 27", esbc.clk, flags=re.MULTILINE)
    assert esbc(clk=[esbc.text("other.clk", other)]).called.refused("rover.rnx", "clock", "CLK", "same days")


def test_clocks_of_another_agency(esbc, plain):
    head, mark, rest = esbc.clk.partition("END OF HEADER")
    other = re.sub("GRG", "COD", head) + mark + rest
    done = esbc(clk=[esbc.text("other.clk", other)])
    assert "different solutions" in done.notes


def test_clocks_without_orbits(esbc):
    assert esbc(sp3=None).called.refused("clk", "--sp3")


@pytest.mark.parametrize("option", ["bias", "antex", "blq", "erp"])
def test_other_products_without_orbits(esbc, option):
    given = {"sp3": None, "clk": None, "antex": None, "nav": esbc.nav} | {option: [esbc.antex]}
    assert esbc(**given).called.refused(option, "--sp3")


@pytest.mark.parametrize("option", ["sp3", "clk", "bias", "antex", "blq", "erp"])
@pytest.mark.parametrize("content", [None, "", "hello\nworld\n"])
def test_a_product_that_is_none_is_named(esbc, option, content):
    path = esbc.folder / f"bad.{option}"
    if content is not None:
        path.write_text(content)
    assert esbc(**{option: [path]}).called.refused(f"bad.{option}")


def test_a_product_of_another_kind_is_named(esbc):
    assert esbc(sp3=[esbc.clk_file]).called.refused("CLK")
    assert esbc(antex=[esbc.sp3[0]]).called.refused("not an ANTEX")
    assert esbc(clk=[esbc.nav]).called.refused("MN.rnx")


def test_satellites_that_the_orbits_lack(esbc, plain):
    # GIVEN orbits without G05 and G07
    less = []
    for path in esbc.sp3:
        lines = gzip.decompress(path.read_bytes()).decode().split("\n")
        kept = "\n".join(line for line in lines if line[:4] not in ("PG05", "PG07"))
        less.append(esbc.text(path.name.removesuffix(".gz"), kept))
    done = esbc(sp3=less)
    if done.called.code:  # a file that breaks its own count of satellites may be refused, by name
        assert done.called.refused("SP3")
        return
    assert re.search(r"no precise orbit: .*G05 \d+, G07 \d+", done.notes)
    assert near(done, plain)


def test_clocks_with_a_gap(esbc, plain):
    gap = "\n".join(x for x in esbc.clk.split("\n") if not re.match(r"AS G05  2020  6 25  0 1[0-4]", x))
    done = esbc(clk=[esbc.text("gap.clk", gap)])
    assert re.search(r"no precise clock: .*G05 1\d", done.notes)
    assert "gap" in next(n for n in done.summary["notes"] if "arcs begin" in n)
    assert near(done, plain)


def test_a_clock_that_jumps(esbc, plain):
    # GIVEN a clock of G05 that the product has 1 microsecond (300 m) off from 00:10 on: a fault of the
    # product
    def jumped(match):
        return f"{match[1]}{float(match[2]) + 1e-6:.12E}"

    late = r"^(AS G05  2020  6 25  0 [1-5]\d +\S+ +2 +)(\S+)"
    text = re.sub(late, jumped, esbc.clk, flags=re.MULTILINE)
    assert text != esbc.clk
    done = esbc(clk=[esbc.text("jump.clk", text)])
    excluded = pl.read_csv(done.folder / "exclusions.csv")["key"].to_list()
    assert "G05" in excluded
    assert near(done, plain, 1.0)


def test_a_bias_file_without_the_signals(esbc, plain, shared):
    # that of another year holds other signals: said for each kind of code
    other = shared / "cpt-van-2019087/CAS0MGXRAP_20190870000_01D_01D_DCB.BSX.gz"
    done = esbc(bias=[other])
    if done.called.code:
        assert done.called.refused("BSX", "day")
    else:
        assert "no code bias of" in done.notes


def test_antennas(esbc, plain):
    assert "no calibration of the receiver's antenna 'ASH701945E_M    SCIS'" in plain.notes
    assert "up may be 5 to 20 cm off" in plain.notes
    bare = esbc(antex=None)
    assert "no satellite antennas (--antex)" in bare.notes
    assert "1 to 3 m off" in bare.notes
    assert near(bare, plain, 3.0)


def test_polar_motion_and_loading_that_do_not_fit(esbc, plain, shared):
    folder = shared / "cpt-van-2019087"
    done = esbc(erp=folder / "COD20464.ERP.gz", blq=folder / "ocnload.blq.gz")
    assert "COD20464.ERP.gz: does not cover the whole log, no pole tide outside" in done.notes
    assert near(done, plain, 0.1)
    named = esbc("--station", "NOSUCH", blq=folder / "ocnload.blq.gz")
    assert "NOSUCH" in named.notes


# --- observations


def edited(epochs, edit):
    out = []
    for k, epoch in enumerate(epochs):
        head, *rows = epoch.rstrip("\n").split("\n")
        rows = [r for r in (edit(k, row) for row in rows) if r]
        out.append("\n".join([f"{head[:32]}{len(rows):3d}{head[35:]}", *rows]) + "\n")
    return out


def test_half_cycle_flags_begin_arcs(esbc, plain):
    # GPS has C1C C1W C2L C2W C5Q D1C D2L D2W D5Q L1C ..: the tenth field is L1C, its flag stands behind it
    at = 3 + 16 * 9 + 14

    def flag(k, row):
        return row[:at] + "2" + row[at + 1 :] if row[:3] == "G05" and k >= 30 and len(row) > at else row

    done = esbc(epochs=edited(esbc.epochs, flag))
    assert "half-cycle ambiguity 1" in done.notes
    assert near(done, plain)


def test_irregular_sampling(esbc, plain):
    # GIVEN epochs that are missing here and there
    done = esbc(epochs=[e for k, e in enumerate(esbc.epochs) if k % 7 not in (2, 3, 5)])
    assert done.summary["epochs"] == sum(k % 7 not in (2, 3, 5) for k in range(EPOCHS))
    assert "gap" not in next(n for n in done.summary["notes"] if "arcs begin" in n)
    assert near(done, plain, 0.5)


def test_a_receiver_clock_that_is_reset_in_code_only(esbc, plain):
    # GIVEN a clock that is set 1 ms ahead: samples are taken 1 ms earlier, codes are 1 ms longer
    def jumped(k, row):
        if k < 30 or row[0] not in "GR":
            return row
        codes, phases, wave = (5, 9, 0.1903) if row[0] == "G" else (5, 10, 0.1871)
        fields = [row[3 + 16 * i : 19 + 16 * i] for i in range((len(row) + 12) // 16)]
        first = next(float(f[:14]) for f in fields[codes:phases] if f[:14].strip())
        for i in range(len(fields)):
            if fields[i][:14].strip() and i < codes:
                value = float(fields[i][:14]) + 299792.458 + 1e-3 * wave * first
                fields[i] = f"{value:14.3f}{fields[i][14:]}"
            elif fields[i][:14].strip() and phases <= i < 2 * phases - codes:
                value = float(fields[i][:14]) + 1e-3 * float(fields[i - phases + codes][:14])
                fields[i] = f"{value:14.3f}{fields[i][14:]}"
        return row[:3] + "".join(fields)

    done = esbc(epochs=edited(esbc.epochs, jumped))
    assert "1 jumps of the receiver clock in code only: carriers moved along" in done.notes
    first, second = (next(n for n in d.summary["notes"] if "arcs begin" in n) for d in (plain, done))
    assert first == second
    assert near(done, plain, 0.02)


@pytest.mark.parametrize("flag", [2, 3, 4, 5])
def test_events_between_epochs(esbc, plain, flag):
    event = f"> 2020 06 25 00 10 15.0000000  {flag}  1\n" + f"{'the antenna moves':<60}COMMENT\n"
    done = esbc(epochs=[*esbc.epochs[:21], event, *esbc.epochs[21:]])
    assert "1 event skipped" in done.notes
    assert near(done, plain, 1e-6)


@pytest.mark.parametrize(
    "position", ["        0.0000        0.0000        0.0000", "  4582105.2910   532589.7313  5232754.8054"]
)
def test_header_coordinates_do_not_matter(esbc, plain, position):
    header = esbc.header.replace("  3582105.2910   532589.7313  5232754.8054", position)
    assert header != esbc.header
    assert near(esbc(header=header), plain, 1e-6)


def test_without_a_second_frequency(esbc):
    def single(k, row):
        return row[:3] + row[3:19] + " " * 16 * 8 + row[3 + 16 * 9 : 3 + 16 * 10] if row[0] == "G" else row

    done = esbc(epochs=edited(esbc.epochs, single), systems="G")
    assert done.called.refused("no satellite can be used", "no second frequency", "two frequencies")


def test_a_fault_on_nobody(esbc):
    assert esbc("--fault", "G33 bias 10 m 600:900").called.refused("G33", "no such row", "G05")


# --- other ways to use it


def test_broadcast_ephemerides_only(esbc, plain):
    done = esbc(sp3=None, clk=None, antex=None, nav=esbc.nav)
    assert "broadcast" in done.notes
    assert "precise orbits" in done.notes
    assert near(done, plain, 10.0)


@pytest.mark.parametrize("estimator", ["spp", "spp_kf"])
def test_the_code_estimators_take_precise_products(esbc, plain, estimator):
    done = esbc(estimator=estimator)
    assert near(done, plain, 6.0)
    assert done.summary["epochs"] == EPOCHS


def test_reasons_are_one_line_each(plain):
    reasons = [n for n in plain.summary["notes"] if n.endswith(f"of {EPOCHS} epochs")]
    heads = [n.partition(":")[0] for n in reasons]
    assert len(heads) == len(set(heads))
    assert any(
        re.fullmatch(r"no second frequency: (\w\d\d \d+, )*\w\d\d \d+ of 61 epochs", n) for n in reasons
    )
