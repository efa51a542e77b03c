"""What the command line makes of what is nearly right."""


def test_a_folder_stands_for_its_record(plain, pnt):
    for command in (
        ["monitor"],
        ["audit", "--monitor", "rctm", "--tests", "1000", "--onsets", "0", "--json"],
    ):
        by_folder, by_file = (pnt(*command, path) for path in (plain.folder, plain.folder / "updates.npz"))
        assert by_folder.code == 0
        assert by_folder.out == by_file.out


def test_a_folder_without_a_record_is_named(tmp_path, pnt):
    assert pnt("monitor", tmp_path).refused("updates.npz", "no such file")


def test_orbits_are_offered_where_ephemerides_are_missing(files, tmp_path, pnt):
    assert pnt("run", "--obs", files.obs, "--out", tmp_path).refused("no nav file", "--nav", "--sp3")


def test_a_field_that_is_none_is_named_with_one_like_it(run, tmp_path):
    config = tmp_path / "bad.toml"
    config.write_text("mask_degs = 10\n")
    assert run("--config", config).called.refused("`mask_degs` is no field", "`mask_deg` is one")
    config.write_text("xyzzy = 10\n")
    assert run("--config", config).called.refused("`xyzzy` is no field of a configuration (docs/formats")
