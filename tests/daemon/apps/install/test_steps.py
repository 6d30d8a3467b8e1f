"""Installation into the image of a machine: modes and owners as documented, repeatable, and removable."""

from __future__ import annotations

import os
import stat
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from daemon.apps.install import config_files, environment, layout, steps
from daemon.apps.install.environment import Source, default_python, fingerprint
from daemon.apps.install.errors import InstallError
from daemon.apps.install.layout import DIRECTORIES, FILES, PREFIX, PROGRAMS, RIG, InstalledPath
from daemon.apps.install.target import MARK, Target, check_prefix, first_closed_directory
from daemon.common.errors import ConfigError
from daemon.config import load_rig, parse_rig
from tests.daemon.apps.install.test_units import needs_systemd
from tests.daemon.bootstrap.systemd.manager import PATIENT

pytestmark = PATIENT

SOURCE = Source(default_python(), shared=True)
OPTIONS = steps.InstallOptions(compile=False)
as_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can change owners")


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """An image with the installed program only; tests must not change it."""
    needs_systemd()
    root = tmp_path_factory.mktemp("image")
    steps.install(Target(root), SOURCE, OPTIONS, print)
    return root  # type: ignore[return-value]


@pytest.fixture
def bare(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An image with a placeholder for the environment: fast, for tests of files only."""
    needs_systemd()

    def fake(target: Target, _: Source) -> bool:
        env = target.path(PREFIX / "env-1/lib/python3.11/site-packages")
        env.mkdir(parents=True, exist_ok=True)
        link = target.path(PREFIX / "env")
        link.unlink(missing_ok=True)
        link.symlink_to("env-1")
        return True

    monkeypatch.setattr(steps.environment, "make", fake)
    monkeypatch.setattr(steps.kernels, "copy_compiled", lambda _: 0)
    root = tmp_path / "image"
    root.mkdir()
    return root


def install(root: Path, **options: object) -> list[str]:
    messages: list[str] = []
    steps.install(Target(root), SOURCE, steps.InstallOptions(compile=False, **options), messages.append)  # type: ignore[arg-type]
    return messages


@as_root
@pytest.mark.parametrize("entry", [*DIRECTORIES, *FILES.values(), *PROGRAMS.values(), layout.CONFIG_FILES], ids=str)
def test_modes_and_owners_are_as_documented(image: Path, entry: InstalledPath) -> None:
    target = Target(image)
    status = target.path(entry.path).stat()
    assert stat.S_IMODE(status.st_mode) == entry.mode
    assert status.st_uid == target.number("passwd", entry.owner)
    assert status.st_gid == target.number("group", entry.group)


@as_root
def test_the_service_owns_nothing_but_its_data_and_nothing_is_open_to_all(image: Path) -> None:
    target = Target(image)
    number, may = target.number("passwd", layout.USER), [entry.path for entry in DIRECTORIES if entry.owner != "root"]
    for path in image.rglob("*"):
        status, entry = path.lstat(), Path("/") / path.relative_to(image)
        if status.st_uid == number:
            assert any(entry.is_relative_to(own) for own in may), entry
        if not path.is_symlink():
            assert not status.st_mode & stat.S_IWOTH, entry


def test_the_program_runs_from_its_installed_location(image: Path) -> None:
    python = image / "opt/fringed/env/bin/python"
    plain = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    code = "import daemon, daemon.apps.install.files as f; print(daemon.__file__); print(f.sources())"
    process = subprocess.run(
        [python, "-P", "-c", code], capture_output=True, text=True, timeout=60, check=True, cwd=image, env=plain
    )
    for line in process.stdout.splitlines():
        assert Path(line).is_relative_to(image / "opt/fringed"), process.stdout


def test_the_packages_are_compiled_to_bytecode(image: Path) -> None:
    (own,) = image.glob("opt/fringed/env/lib/python3.*/site-packages")
    for package in environment.OWN:
        sources = {path.stem for path in (own / package).rglob("*.py")}
        assert {path.name.partition(".")[0] for path in (own / package).rglob("*.pyc")} == sources


def test_the_command_names_the_prefix_and_takes_nothing_from_the_current_directory(image: Path) -> None:
    text = (image / "opt/fringed/bin/fringed").read_text()
    assert "exec /opt/fringed/env/bin/python -P -c" in text
    assert (image / "usr/local/bin/fringed").readlink() == Path("/opt/fringed/bin/fringed")


def test_the_installed_rig_file_is_valid(image: Path) -> None:
    config = parse_rig((image / "etc/fringed/rig.yaml").read_text())
    assert Path(config.recording.dir).is_relative_to(layout.STATE)
    assert Path(config.selfcheck.dir).is_relative_to(layout.STATE)
    assert (image / "etc/systemd/system/multi-user.target.wants/fringed.service").is_symlink()
    assert not (image / "etc/systemd/system/fringed.service.wants").exists()  # a simulated rig needs no X server


def test_a_second_installation_changes_nothing(image: Path) -> None:
    # Tests that run at the same time compile kernels, which the second installation copies, too.
    compiled = Target(image).path(layout.KERNELS)

    def all_times() -> dict[Path, int]:
        kept = (path for path in image.rglob("*") if path.is_file() and "etc/." not in str(path))
        kept = (path for path in kept if not path.is_relative_to(compiled))
        return {path: path.stat().st_mtime_ns for path in kept if path.name != MARK}

    before, messages = all_times(), []
    steps.install(Target(image), SOURCE, OPTIONS, messages.append)
    after = all_times()
    assert {path for path in after if after[path] != before.get(path)} == set()
    assert messages == [f"installed into the image {image}"]


def test_a_rig_file_of_the_user_is_kept_and_the_new_one_written_beside_it(bare: Path) -> None:
    install(bare)
    rig = bare / RIG.relative_to("/")
    rig.write_text("# mine\n")
    messages = install(bare)
    assert rig.read_text() == "# mine\n"
    assert rig.with_name("rig.yaml.new").read_text() == config_files.SIMULATED
    assert any("rig.yaml is kept" in text for text in messages)


def test_the_files_named_by_a_rig_file_are_installed_too(bare: Path, tmp_path: Path) -> None:
    (tmp_path / "volume.json").write_text('{"near_mm": 300.0, "far_mm": 900.0}')
    rig = tmp_path / "rig.yaml"
    rig.write_text("cameras: {driver: sim}\nvolume: volume.json\n")
    install(bare, rig=rig)
    assert (bare / "etc/fringed/volume.json").read_bytes() == (tmp_path / "volume.json").read_bytes()


def test_a_service_writes_below_its_state_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text("cameras: {driver: sim}\nrecording: {dir: takes}\nselfcheck: {dir: /srv/check}\n")
    assert load_rig(rig).recording.dir == "takes"
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/fringed")
    config = load_rig(rig)
    assert (config.recording.dir, config.selfcheck.dir) == ("/var/lib/fringed/takes", "/srv/check")


def test_a_rig_with_the_x11_projector_gets_the_x_server(bare: Path, tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text("cameras: {driver: sim}\n")
    install(bare, rig=rig)
    (bare / RIG.relative_to("/")).write_text("projector: {driver: x11}\n")
    install(bare, view=True)
    wants = bare / "etc/systemd/system"
    assert (wants / "fringed.service.wants/fringed-projector-x.service").is_symlink()
    assert (wants / "multi-user.target.wants/fringed-view.service").is_symlink()


def test_an_invalid_rig_file_is_rejected_before_any_change(bare: Path, tmp_path: Path) -> None:
    rig = tmp_path / "bad.yaml"
    rig.write_text("cameras: {driver: smi}\n")
    with pytest.raises(ConfigError, match="smi"):
        install(bare, rig=rig)
    rig.write_text("cameras: {driver: sim}\nvolume: ../volume.json\n")
    (tmp_path.parent / "volume.json").write_text('{"near_mm": 300.0, "far_mm": 900.0}')
    with pytest.raises((InstallError, ConfigError)):
        install(bare, rig=rig)
    assert list(bare.iterdir()) == []


def test_another_prefix_is_written_into_every_file(bare: Path) -> None:
    target = Target(bare, Path("/srv/rig/fringed"))
    steps.install(target, SOURCE, OPTIONS, lambda _: None)
    assert not (bare / "opt").exists()
    for entry in (*FILES.values(), *PROGRAMS.values()):
        assert "/opt/fringed" not in target.path(entry.path).read_text(), entry.path
    assert "ExecStart=/srv/rig/fringed/bin/fringed run" in (bare / "etc/systemd/system/fringed.service").read_text()
    steps.uninstall(target, lambda _: None)
    assert not (bare / "srv/rig/fringed").exists()


@pytest.mark.parametrize(
    "prefix",
    ["/", "/usr", "/usr/local", "/etc", "/opt", "/var/lib", "/tmp/x", "/dev/x", "opt/fringed", "/opt/../usr",
     "/opt/a b", "/opt/$HOME", "/home", "/root"],
)  # fmt: skip
def test_prefixes_of_the_system_are_rejected(tmp_path: Path, prefix: str) -> None:
    with pytest.raises(InstallError, match="choose a directory of its own"):
        check_prefix(Target(tmp_path, Path(prefix)))


def test_a_prefix_with_other_files_or_a_link_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "opt/other").mkdir(parents=True)
    (tmp_path / "opt/other/file").touch()
    (tmp_path / "opt/link").symlink_to("other")
    for prefix in ("/opt/other", "/opt/link", "/opt/other/file"):
        with pytest.raises(InstallError):
            check_prefix(Target(tmp_path, Path(prefix)))
    (tmp_path / "opt/other" / MARK).write_text("{}")
    check_prefix(Target(tmp_path, Path("/opt/other")))


def test_uninstall_keeps_data_and_configuration(bare: Path) -> None:
    install(bare)
    take = bare / "var/lib/fringed/takes/a.mcap"
    take.touch()
    messages: list[str] = []
    steps.uninstall(Target(bare), messages.append)
    assert take.exists() and (bare / "etc/fringed/rig.yaml").exists()
    for entry in (*FILES.values(), *PROGRAMS.values()):
        assert not (bare / entry.path.relative_to("/")).exists()
    for path in ("opt/fringed", "var/cache/fringed", "usr/local/bin/fringed"):
        assert not os.path.lexists(bare / path)
    assert not list((bare / "etc/systemd/system").rglob("*fringed*"))
    assert "are kept" in messages[-1]
    with pytest.raises(InstallError, match="nothing is installed"):
        steps.uninstall(Target(bare), messages.append)


def test_purge_removes_everything(bare: Path) -> None:
    install(bare)
    drop_in = bare / "etc/systemd/system/fringed.service.d/override.conf"
    drop_in.parent.mkdir()
    drop_in.touch()
    steps.uninstall(Target(bare), lambda _: None, purge=True)
    for path in ("var/lib/fringed", "etc/fringed", "var/log/fringed", "opt/fringed"):
        assert not (bare / path).exists()
    assert not drop_in.parent.exists()
    if os.geteuid() == 0:
        assert "fringed" not in (bare / "etc/passwd").read_text()


def test_a_foreign_command_of_the_same_name_is_kept(bare: Path) -> None:
    other = bare / "usr/local/bin/fringed"
    other.parent.mkdir(parents=True)
    other.write_text("mine")
    install(bare)
    assert other.read_text() == "mine"
    steps.uninstall(Target(bare), lambda _: None)
    assert other.read_text() == "mine"


def test_an_interpreter_without_access_for_the_service_is_rejected(tmp_path: Path) -> None:
    closed = tmp_path / "home/bin"
    closed.mkdir(parents=True)
    python = closed / "python3"
    python.touch()
    (tmp_path / "home").chmod(0o700)
    assert first_closed_directory(python) is not None
    with pytest.raises(InstallError, match=r"cannot enter .*; give an interpreter"):
        Source(python).check(Target())


def test_the_previous_environment_is_kept_for_a_daemon_that_runs_in_it(tmp_path: Path) -> None:
    target = Target(tmp_path, Path("/opt/fringed"))
    prefix = target.path(PREFIX)
    for number, name in enumerate(("env-a", "env-b", "env-c", "env-broken")):
        (prefix / name).mkdir(parents=True)
        if name != "env-broken":
            mark = prefix / name / "made-from"
            mark.touch()
            os.utime(mark, (number, number))
    (prefix / "env").symlink_to("env-c")
    environment.remove_old(target)
    assert {path.name for path in prefix.iterdir()} == {"env", "env-b", "env-c"}


def test_the_environment_is_identified_by_its_inputs() -> None:
    assert fingerprint(SOURCE) == fingerprint(SOURCE) != fingerprint(Source(default_python()))


def test_the_command_reports_the_reason_of_a_failure(fringed: object, tmp_path: Path) -> None:
    process = fringed("install", "--root", str(tmp_path / "none"), "--prefix", "/opt/x")  # type: ignore[operator]
    assert process.returncode == 1 and "create it first" in process.stderr
    process = fringed("install", "--root", str(tmp_path), "--prefix", "/usr")  # type: ignore[operator]
    assert process.returncode == 1 and "belongs to the system" in process.stderr
    assert list(tmp_path.iterdir()) == []
