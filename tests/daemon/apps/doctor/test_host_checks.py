"""Areas that read files of the machine: USB, network, permissions, processors, memory, sockets, disk, clock."""

from __future__ import annotations

import dataclasses
import os
import socket
from pathlib import Path

import pytest

from daemon.apps.doctor.cameras import device_permissions, network, usb
from daemon.apps.doctor.host import clock, disk, memory, processors, sockets
from daemon.apps.doctor.machine import Machine, Program
from daemon.apps.doctor.subject import Subject
from tests.daemon.apps.doctor import fake_machines
from tests.daemon.apps.doctor.fake_machines import by_name, levels

CAMERA = {
    "/sys/bus/usb/devices/2-1/speed": "5000",
    "/sys/bus/usb/devices/2-1/product": "Cam 5M",
    "/sys/bus/usb/devices/2-1/idVendor": "2676",
    "/sys/bus/usb/devices/2-1/busnum": "2",
    "/sys/bus/usb/devices/2-1/devnum": "7",
    "/sys/bus/usb/devices/2-1:1.0/bInterfaceClass": "ef",
    "/sys/bus/usb/devices/2-1:1.0/bInterfaceSubClass": "05",
    "/dev/bus/usb/002/007": "",
}
NETWORK = {
    "/sys/class/net/eth7/type": "1",
    "/sys/class/net/eth7/operstate": "up",
    "/sys/class/net/eth7/device/vendor": "0x8086",
}


class InaccessibleMachine(Machine):
    """A machine whose device files are not accessible."""

    def may_use(self, path: Path) -> bool:  # noqa: ARG002
        return False


@pytest.mark.parametrize(("limit", "level"), [("16", "warning"), ("1000", "ok"), ("0", "ok")])
def test_usb_memory_is_compared_with_the_need_of_two_cameras(tmp_path: Path, limit: str, level: str) -> None:
    found = list(usb.check(fake_machines.subject(tmp_path, CAMERA | {usb.MEMORY: limit})))
    (memory_,) = by_name(found, "memory")
    assert memory_.level == level and by_name(found, "speed")[0].level == "ok"
    assert level == "ok" or "usbfs_memory_mb" in memory_.remedy


def test_a_usb3_camera_in_a_usb2_port_is_reported(tmp_path: Path) -> None:
    files = CAMERA | {"/sys/bus/usb/devices/2-1/speed": "480", usb.MEMORY: "1000"}
    (speed,) = by_name(usb.check(fake_machines.subject(tmp_path, files)), "speed")
    assert speed.level == "warning" and "Cam 5M runs at 480" in speed.text


@pytest.mark.parametrize(
    ("mtu", "speed", "level", "word"),
    [("1500", "1000", "note", "mtu 9000"), ("9000", "1000", "ok", ""), ("9000", "100", "note", "Gigabit")],
)
def test_network_interfaces(tmp_path: Path, mtu: str, speed: str, level: str, word: str) -> None:
    files = NETWORK | {"/sys/class/net/eth7/mtu": mtu, "/sys/class/net/eth7/speed": speed, network.RMEM: "33554432"}
    found = list(network.check(fake_machines.subject(tmp_path, files)))
    assert [(finding.name, finding.level) for finding in found] == [("eth7", level), ("rmem_max", "ok")]
    assert word in found[0].remedy


def test_with_genicam_cameras_in_the_rig_a_small_receive_buffer_is_a_warning(tmp_path: Path) -> None:
    fake_machines.write_rig_files(tmp_path)
    subject = fake_machines.subject(tmp_path, {network.RMEM: "212992"}, fake_machines.genicam())
    (found,) = by_name(network.check(subject), "rmem_max")
    assert found.level == "warning" and "sysctl -w net.core.rmem_max" in found.remedy


def test_virtual_and_inactive_interfaces_are_left_out(tmp_path: Path) -> None:
    files = {"/sys/class/net/lo/type": "772", "/sys/class/net/br0/type": "1", "/sys/class/net/br0/operstate": "up"}
    down = NETWORK | {"/sys/class/net/eth7/operstate": "down"}
    assert network.interfaces(fake_machines.subject(tmp_path, files | down)) == []


def test_inaccessible_device_files_name_the_group_to_join(tmp_path: Path) -> None:
    fake_machines.machine(tmp_path, {"/dev/video0": "", "/dev/video1": "", "/dev/dri/renderD128": "", "/etc/group": ""})
    found = list(device_permissions.check(Subject(InaccessibleMachine(tmp_path, {}))))
    wrong = [finding for finding in found if finding.level == "warning"]
    assert len(wrong) == 2 and all("usermod -aG" in finding.remedy for finding in wrong)
    assert "/dev/video0, /dev/video1, which belong to group" in wrong[0].text
    assert levels(device_permissions.check(Subject(Machine(tmp_path, {})))) == ["ok"]


def test_a_usb3_camera_without_a_rule_is_reported_with_the_rule_to_add(tmp_path: Path) -> None:
    fake_machines.machine(tmp_path, CAMERA)
    (found,) = by_name(device_permissions.check(Subject(InaccessibleMachine(tmp_path, {}))), "udev")
    assert 'ATTRS{idVendor}=="2676"' in found.remedy and "no udev rule" in found.text
    fake_machines.machine(tmp_path, {"/etc/udev/rules.d/69-cam.rules": 'ATTRS{idVendor}=="2676", GROUP="plugdev"'})
    (found,) = by_name(device_permissions.check(Subject(InaccessibleMachine(tmp_path, {}))), "udev")
    assert "a udev rule" in found.text and "udevadm" in found.remedy


def test_processors_that_the_rig_requests_must_exist(tmp_path: Path) -> None:
    available = min(os.sched_getaffinity(0))
    rig = f"cameras: {{driver: sim}}\npipeline: {{cpus: [{available}, 4000], threads: 200}}\n"
    subject = fake_machines.subject(tmp_path, rig=rig)
    found = list(processors.requested_cpus(subject, frozenset(os.sched_getaffinity(0))))
    assert levels(found) == ["problem", "warning"] and "4000" in found[0].text and "threads" in found[1].text


def test_numba_has_a_threading_layer() -> None:
    assert processors.numba_layer().level in ("ok", "warning")


@pytest.mark.parametrize(("driver", "count"), [("acpi-cpufreq", 1), ("intel_pstate", 0)])
def test_the_lowest_frequency_is_reported_only_where_powersave_means_that(
    tmp_path: Path, driver: str, count: int
) -> None:
    directory = "/sys/devices/system/cpu/cpu0/cpufreq"
    files = {f"{directory}/scaling_governor": "powersave", f"{directory}/scaling_driver": driver}
    assert len(list(processors.governor(fake_machines.subject(tmp_path, files)))) == count


@pytest.mark.parametrize(("available_kb", "level"), [(300_000, "problem"), (800_000, "warning"), (8_000_000, "ok")])
def test_memory(tmp_path: Path, available_kb: int, level: str) -> None:
    text = f"MemTotal: 16000000 kB\nMemAvailable: {available_kb} kB\nSwapTotal: 0 kB\nSwapFree: 0 kB\n"
    assert levels(memory.check(fake_machines.subject(tmp_path, {"/proc/meminfo": text}))) == [level]


def test_the_states_of_a_socket_file(tmp_path: Path) -> None:
    machine, path = Machine(), tmp_path / "s"
    endpoint = f"ipc://{path}"
    assert sockets.local(machine, "stream", endpoint, path).level == "ok"
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(path))
        server.listen()
        taken = sockets.local(machine, "stream", endpoint, path)
        assert taken.level == "problem" and f"process {os.getpid()}" in taken.text
    left = sockets.local(machine, "stream", endpoint, path)
    assert left.level == "ok" and "its file is left" in left.text
    path.unlink()
    path.write_text("")
    assert "is no socket" in sockets.local(machine, "stream", endpoint, path).text


def test_a_port_in_use_names_its_process() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        number = server.getsockname()[1]
        found = sockets.port(Machine(), "stream", f"tcp://127.0.0.1:{number}")
        assert found.level == "problem" and f"process {os.getpid()}" in found.text
    assert sockets.port(Machine(), "stream", f"tcp://127.0.0.1:{number}").level == "ok"
    assert sockets.port(Machine(), "stream", "tcp://127.0.0.1:*").level == "ok"


def test_a_port_on_all_addresses_and_ipv6_are_read_from_proc(tmp_path: Path) -> None:
    head = "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode\n"
    rest = "00000000:0000 0A 00000000:00000000 00:00000000 00000000     0        0 4711 1"
    loopback6 = "0" * 24 + "01000000"
    text4, text6 = f"{head}   0: 00000000:15B3 {rest}\n", f"{head}   0: {loopback6}:15B4 {rest}\n"
    machine = fake_machines.machine(tmp_path, {"/proc/net/tcp": text4, "/proc/net/tcp6": text6})
    found = sockets.port(machine, "stream", "tcp://127.0.0.1:5555")
    assert found.level == "problem" and "another user" in found.text
    assert [str(address) for address, _ in sockets.listening(machine, 5556)] == ["::1"]
    assert sockets.port(machine, "stream", "tcp://127.0.0.1:5556").level == "ok"


def test_a_running_daemon_is_a_warning_with_its_process_id() -> None:
    program = Program(77, "fringed", "python3 /usr/bin/fringed run rig.yaml")
    found = sockets.in_use("control", "ipc:///x", program)
    assert found.level == "warning" and "kill -INT 77" in found.remedy


def test_a_directory_that_cannot_be_created_is_a_problem(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert sockets.writable(tmp_path / "new" / "deep").level == "ok"
    assert sockets.writable(tmp_path / "file" / "deep").level == "problem"


def test_the_disk_measurement_leaves_no_file(tmp_path: Path) -> None:
    assert disk.measure(tmp_path, 8 << 20) > 0
    assert list(tmp_path.iterdir()) == []


def test_free_space_and_speed_are_compared_with_the_cameras_data_rate(tmp_path: Path) -> None:
    assert disk.room(tmp_path, 500.0, 1024.0, 0.0).level == "problem"
    assert disk.room(tmp_path, 2000.0, 1024.0, 100.0).level == "warning"
    assert disk.room(tmp_path, 90_000.0, 1024.0, 100.0).level == "ok"
    assert disk.speed(80.0, 10.0, 20.0).level == "warning"
    assert disk.speed(400.0, 10.0, 20.0).level == "ok"
    assert "40 pairs/s" in disk.speed(400.0, 10.0, 0.0).text


@pytest.mark.parametrize(
    ("text", "level"),
    [
        ("A29FC87B,time.example,3,1700000000.1,0.000012,-0.00001,0.00002,1,0,0,0.01,0.002,64.2,Normal", "ok"),
        ("A29FC87B,time.example,3,1700000000.1,-0.120000,-0.1,0.1,1,0,0,0.01,0.002,64.2,Normal", "warning"),
        ("00000000,,0,0.0,0.0,0.0,0.0,0,0,0,1,1,0.0,Not synchronised", "warning"),
        ("what", "note"),
    ],
)
def test_chrony(text: str, level: str) -> None:
    assert clock.chrony(text).level == level


def test_the_answers_of_systemd() -> None:
    assert [clock.systemd(text).level for text in ("yes", "no")] == ["ok", "warning"]


def test_programs_are_read_from_proc(tmp_path: Path) -> None:
    files = {"/proc/5/comm": "redshift\n", "/proc/5/cmdline": "redshift\0-l\0", "/proc/self/comm": "me"}
    machine = fake_machines.machine(tmp_path, files)
    assert list(machine.programs()) == [Program(5, "redshift", "redshift -l")]
    assert dataclasses.replace(machine, root=tmp_path / "none").number("/proc/x") is None
