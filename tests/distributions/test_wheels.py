"""The client's wheel holds nothing but ``fringed``; foreign packages stay whole, and the rig's commands name them."""

from __future__ import annotations

import hashlib
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

from tools.release import ROOT, build_wheels, write_checksums
from tools.release_check import check_versions

OWN = "daemon", "drivers", "pipeline", "sim", "fringed"


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    built = build_wheels(tmp_path_factory.mktemp("dist"), None)
    return {path.name.split("-")[0]: path for path in built}


def names(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as file:
        return {name for name in file.namelist() if ".dist-info/" not in name}


def test_every_file_is_in_one_wheel(wheels: dict[str, Path]) -> None:
    client, rig = names(wheels["fringed"]), names(wheels["fringed_rig"])
    assert {name.split("/")[0] for name in client} == {"fringed"}
    sources = {str(path.relative_to(ROOT)) for package in OWN for path in (ROOT / package).rglob("*.py")}
    assert sources <= client | rig and not client & rig
    assert {f"{package}/py.typed" for package in OWN} <= client | rig
    shared = {name.partition("/share/fringed/")[2] for name in rig if ".data/data/share/" in name}
    expected = {str(path.relative_to(ROOT)) for path in (ROOT / "systemd").rglob("*") if path.is_file()}
    assert shared == expected | {"constraints.txt", "LICENSE", "schema/fringed.schema.json"}


def test_the_checksums_are_those_of_all_files(tmp_path: Path) -> None:
    for name in ("a.whl", "kernels/b.json"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(name)
    sums = write_checksums(tmp_path)
    check = ["sha256sum", "--check", "--strict", write_checksums(tmp_path).name]
    assert len(sums.read_text().splitlines()) == 2
    assert subprocess.run(check, cwd=tmp_path, capture_output=True, check=False).returncode == 0
    (tmp_path / "kernels/b.json").write_text("other")
    assert subprocess.run(check, cwd=tmp_path, capture_output=True, check=False).returncode == 1


PLACES = {
    "pyproject.toml": 'version = "',
    "distributions/rig/pyproject.toml": '"fringed==',
    "CITATION.cff": "version: ",
    "CHANGELOG.md": "## ",
}


def test_one_version_is_named_everywhere() -> None:
    client, rig = (
        tomllib.loads((ROOT / folder / "pyproject.toml").read_text())["project"] for folder in ("", "distributions/rig")
    )
    assert check_versions(ROOT) == client["version"]
    assert client["requires-python"] == rig["requires-python"]


@pytest.mark.parametrize("place", PLACES)
def test_another_version_at_one_place_is_named(place: str, tmp_path: Path) -> None:
    for name in PLACES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        text = (ROOT / name).read_text()
        (tmp_path / name).write_text(text.replace(PLACES[name] + "0", PLACES[name] + "9") if name == place else text)
    with pytest.raises(ValueError, match=rf"^versions differ: .*{place}.*: 9\."):
        check_versions(tmp_path)


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """The site-packages of a new environment that holds a foreign package ``daemon``."""
    venv.create(tmp_path / "env", with_pip=False, symlinks=True)
    (site,) = (tmp_path / "env").glob("lib/python3.*/site-packages")
    for name in ("daemon/__init__.py", "daemon/pidfile.py"):
        (site / name).parent.mkdir(exist_ok=True)
        (site / name).write_text('"""Another program."""\n')
    record = site / "python_daemon-3.1.2.dist-info"
    record.mkdir()
    (record / "METADATA").write_text("Metadata-Version: 2.1\nName: python-daemon\nVersion: 3.1.2\n")
    (record / "RECORD").write_text("daemon/__init__.py,,\ndaemon/pidfile.py,,\n")
    (record / "top_level.txt").write_text("daemon\n")
    return site


def install(site: Path, *wheels: Path) -> Path:
    python = site.parents[2] / "bin/python"
    command = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet", "--no-deps", "--no-index"]
    command += ["--no-compile"]
    subprocess.run([*command, *map(str, wheels)], check=True, capture_output=True)
    (site / "others.pth").write_text(f"{sysconfig.get_paths()['purelib']}\n")
    return python


def digests(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.rglob("*.py")}


def module(python: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [python, "-P", "-m", "fringed", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, cwd=python.parent)


def test_a_foreign_package_stays_whole_beside_the_client(foreign: Path, wheels: dict[str, Path]) -> None:
    before = digests(foreign / "daemon")
    python = install(foreign, wheels["fringed"])
    assert digests(foreign / "daemon") == before
    code = "import daemon, fringed; print(daemon.__doc__, fringed.subscribe.__module__)"
    done = subprocess.run([python, "-P", "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout == "Another program. fringed.stream.subscription\n"


def test_the_commands_name_a_foreign_package(foreign: Path, wheels: dict[str, Path]) -> None:
    python = install(foreign, wheels["fringed"], wheels["fringed_rig"])
    assert module(python, "--version").stdout == "fringed 0.1.0\n"
    assert module(python, "-h").returncode == 0
    (foreign / "daemon/__init__.py").write_text('"""Another program, installed later."""\n')
    done = module(python, "status")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert (
        f"the package 'daemon' in {foreign / 'daemon'} is not that of fringed-rig but of python-daemon" in done.stderr
    )
    script = subprocess.run([python.with_name("fringed"), "status"], capture_output=True, text=True, check=False)
    assert script.stderr == done.stderr
