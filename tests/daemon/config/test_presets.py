"""Presets: beneath what rig.yaml sets, own ones in files, mistakes named."""

from pathlib import Path

import pytest

from daemon.common.errors import ConfigError, InputError
from daemon.config.load import parse_rig
from daemon.config.presets import BUILT_IN, preset_names, preset_path, read_preset
from daemon.control.settings.flatten import settings_of, with_value
from pipeline.common.settings import Settings

RIG = "cameras: {driver: sim}\n"


def test_balanced_are_the_defaults() -> None:
    assert parse_rig(RIG + "preset: balanced\n") == parse_rig(RIG)
    assert settings_of(parse_rig(RIG)) == Settings()


@pytest.mark.parametrize("name", [name for name in BUILT_IN if name != "balanced"])
def test_every_preset_is_valid_and_changes_something(name: str) -> None:
    config = parse_rig(f"{RIG}preset: {name}\n")
    assert settings_of(config) == Settings().with_overrides(BUILT_IN[name].get("settings", {}))
    assert config.pipeline != parse_rig(RIG).pipeline


def test_the_file_itself_comes_first() -> None:
    config = parse_rig(f"{RIG}preset: precise\npipeline: {{temporal: off, settings: {{cluster_min_area: 50}}}}\n")
    assert config.pipeline.temporal == "off" and settings_of(config).cluster_min_area == 50
    assert settings_of(config).smoothing_sigma_px == BUILT_IN["precise"]["settings"]["smoothing_sigma_px"]


def test_an_own_preset_lies_beside_the_rig(tmp_path: Path) -> None:
    (tmp_path / "presets").mkdir()
    (tmp_path / "presets" / "mine.yaml").write_text("fringed_preset: 1\nsettings: {downsampling: 2}\n")
    assert preset_names(tmp_path)[-1] == "mine"
    assert settings_of(parse_rig(f"{RIG}preset: mine\n", base_dir=tmp_path)).downsampling == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("settings: {}\n", "fringed_preset: 1"),
        ("fringed_preset: 1\nthreads: 2\n", "unknown key 'threads'"),
        ("fringed_preset: 1\nsettings: {downsampling: 0}\n", "downsampling is 0, allowed 1 to 8"),
        ("fringed_preset: 1\nsettings: 3\n", "must be a section"),
        ("{", "YAML syntax"),
    ],
)
def test_a_wrong_preset_is_refused_with_its_file(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "presets").mkdir()
    (tmp_path / "presets" / "mine.yaml").write_text(text)
    with pytest.raises(InputError, match=rf"mine\.yaml.*{message}"):
        read_preset("mine", tmp_path)


def test_an_unknown_preset_is_refused_with_those_that_exist(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="2:9: preset: there is no preset 'precis'; did you mean precise"):
        parse_rig(f"{RIG}preset: precis\n", base_dir=tmp_path)
    with pytest.raises(InputError, match="there are: precise, balanced, fast, dynamic"):
        read_preset("xyz", tmp_path)
    for name, message in (("fast", "built in"), ("../x", "letters, digits")):
        with pytest.raises(InputError, match=message):
            preset_path(name, tmp_path)


def test_a_live_change_of_the_preset_replaces_settings_and_a_change_of_one_keeps_the_preset(tmp_path: Path) -> None:
    start = parse_rig(f"{RIG}preset: fast\npipeline: {{settings: {{cluster_min_area: 50}}}}\n")
    default = with_value(start, settings_of(start), "pipeline.settings.lattice_x", 3, tmp_path)
    assert settings_of(default).lattice_x == 3 and settings_of(default).lattice_y == 6 and default.preset == "fast"
    used = with_value(default, settings_of(default), "preset", "precise", tmp_path)
    assert settings_of(used) == Settings().with_overrides(BUILT_IN["precise"]["settings"])
    assert (used.pipeline.temporal, used.pipeline.overload) == ("fuse", "skip")
    assert settings_of(with_value(used, settings_of(used), "preset", "balanced", tmp_path)) == Settings()
