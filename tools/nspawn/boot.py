"""``python -m tools.nspawn.boot``: makes the container's root in namespaces of its own, then becomes systemd-nspawn.

The root is an overlay of memory over this machine's root, which is effectively read only. Both mounts belong to the
mount namespace of this process and end with it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import uuid
from pathlib import Path

CHECKOUT = "/checkout"
"""Path of the project in the container."""
VENV = "/opt/venv"
"""Path of an environment with the packages of the one that runs the tests."""
PYTHON = "/opt/python"
"""Path of an interpreter that is not the system's; a service has no access to home directories."""

# Files of this machine, hidden in the container, whose /run, /tmp and /dev are new in any case.
_REMOVED = (
    "etc/fringed",
    "etc/machine-id",
    "etc/systemd/system",
    "etc/systemd/user",
    "opt/fringed",
    "usr/local/bin/fringed",
    "opt/python",
    "opt/venv",
    "var/cache/fringed",
    "var/lib/dbus/machine-id",
    "var/lib/fringed",
    "var/log/fringed",
    "var/log/journal",
)
_MASKED = (
    "apt-daily.timer",
    "apt-daily-upgrade.timer",
    "console-getty.service",
    "dpkg-db-backup.timer",
    "e2scrub_all.timer",
    "e2scrub_reap.service",
    "fstrim.timer",
    "getty.target",
    "man-db.timer",
    "networking.service",
    "systemd-firstboot.service",
    "systemd-networkd.service",
    "systemd-network-generator.service",
    "systemd-resolved.service",
    "systemd-timesyncd.service",
)
_JOURNAL = "[Journal]\nStorage=volatile\nRateLimitBurst=0\nRuntimeMaxUse=64M\nForwardToSyslog=no\nForwardToWall=no\n"


def main() -> None:
    """Boot; arguments: mount point, the machine's name, the checkout, the packages, ``sys.base_prefix``."""
    folder, name, checkout, packages, base_prefix = sys.argv[1:6]
    os.umask(0o022)  # files of the container are for all its users, whatever umask this process inherited
    root = mount(Path(folder))
    prepare(root)
    # Writable, else compiled kernels beside the sources are not used; writes are discarded with the container.
    own = overlay(Path(folder), "checkout", checkout)
    binds = [f"--bind={own}:{CHECKOUT}", f"--bind-ro={packages}:{VENV}/{Path(packages).relative_to(sys.prefix)}"]
    if not base_prefix.startswith("/usr"):
        binds.append(f"--bind-ro={base_prefix}:{PYTHON}")
        # The interpreter is linked with its library by a path that a service cannot access.
        (root / "etc/ld.so.conf.d/000-fringed-test.conf").write_text(f"{PYTHON}/lib\n")
    make_environment(root, base_prefix if base_prefix.startswith("/usr") else PYTHON)
    start(root, name, binds)


def make_environment(root: Path, base: str) -> None:
    """Make the files of ``python -m venv`` around existing packages."""
    programs = root / VENV[1:] / "bin"
    programs.mkdir(parents=True)
    program = f"{base}/bin/python{sys.version_info.major}.{sys.version_info.minor}"
    (programs / "python").symlink_to(program)
    (programs.parent / "pyvenv.cfg").write_text(f"home = {base}/bin\ninclude-system-site-packages = false\n")


def mount(folder: Path) -> Path:
    """Mount the container's root below an existing folder."""
    subprocess.run(["mount", "-t", "tmpfs", "-o", "mode=755,size=6g", "fringed-nspawn", str(folder)], check=True)
    return overlay(folder, "root", "/")


def overlay(folder: Path, name: str, lower: str) -> Path:
    """Mount a writable overlay of a directory, which itself does not change."""
    upper, work, merged = (folder / f"{name}-{part}" for part in ("upper", "work", "merged"))
    for made in (upper, work, merged):
        made.mkdir()
    upper.chmod(0o755)
    options = f"lowerdir={_escaped(lower)},upperdir={upper},workdir={work}"
    subprocess.run(["mount", "-t", "overlay", "-o", options, "overlay", str(merged)], check=True)
    return merged


def _escaped(path: str) -> str:
    """Escape a path for the mount options, where colons and commas are separators."""
    return path.replace("\\", "\\\\").replace(":", "\\:").replace(",", "\\,")


def prepare(root: Path) -> None:
    """Remove the units that this machine starts at boot, and earlier installations."""
    assert root.is_mount(), f"{root} is no overlay; nothing may be removed from there"
    for gone in _REMOVED:
        path = root / gone
        if path.is_symlink() or path.is_file():
            path.unlink()
        elif path.is_dir():
            shutil.rmtree(path)
    units = root / "etc/systemd/system"
    units.mkdir(parents=True)
    (root / "etc/systemd/user").mkdir()
    (units / "default.target").symlink_to("/lib/systemd/system/multi-user.target")
    for unit in _MASKED:
        (units / unit).symlink_to("/dev/null")
    (root / "etc/machine-id").write_text(f"{uuid.uuid4().hex}\n")
    journald = root / "etc/systemd/journald.conf.d"
    journald.mkdir(parents=True, exist_ok=True)
    (journald / "test.conf").write_text(_JOURNAL)


def start(root: Path, name: str, binds: list[str]) -> None:
    """Become systemd-nspawn; does not return."""
    command = ["systemd-nspawn", "--quiet", f"--directory={root}", f"--machine={name}", "--boot", *binds]
    # Not registered with a systemd outside, which may be absent; no terminal; a network of its own, loopback only.
    command += ["--register=no", "--keep-unit", "--link-journal=no", "--console=pipe", "--private-network"]
    command += ["--resolv-conf=off", "--timezone=off", "--", "--show-status=no", "--log-target=journal"]
    os.execvp(command[0], command)


if __name__ == "__main__":
    main()
