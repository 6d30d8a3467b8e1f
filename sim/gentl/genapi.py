"""Device descriptions in the GenApi XML that GenICam programs read: features and their registers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from xml.etree import ElementTree as ET

Child = tuple[str, object]
_SCHEMA = "http://www.genicam.org/GenApi/Version_1_1"


@dataclass
class Registers:
    """Addresses of named registers, allocated in the order of the first calls."""

    prefix: str
    end: int
    _allocated: dict[str, tuple[int, int, int]] = field(default_factory=dict)

    def address(self, name: str, length: int, count: int = 1) -> int:
        """Address of ``count`` registers of ``length`` bytes each, allocated at the first call."""
        if name not in self._allocated:
            self._allocated[name] = (self.end, length, count)
            self.end = (self.end + length * count + 7) // 8 * 8
        address, first_length, first_count = self._allocated[name]
        if (length, count) != (first_length, first_count):
            raise ValueError(f"register {name}: {count} of {length} bytes, was {first_count} of {first_length}")
        return address

    def header(self) -> str:
        """C constants of the addresses and lengths."""
        lines = [f"#define {self.prefix}_{name} 0x{entry[0]:X}u" for name, entry in self._allocated.items()]
        return "\n".join([*lines, f"#define {self.prefix}_END 0x{self.end:X}u", ""])


@dataclass(frozen=True, slots=True)
class By:
    """A register that exists once for each entry of a selector."""

    selector: str
    count: int


class Description:
    """One device description: features in categories, over the registers of one port.

    Args:
        model: name of the description; port: name of the port's node; registers: that allocate the addresses.
        renamed: other names for some features; left_out: features that this model lacks.
    """

    def __init__(
        self,
        model: str,
        registers: Registers,
        *,
        port: str = "Device",
        renamed: dict[str, str] | None = None,
        left_out: Iterable[str] = (),
    ) -> None:
        self._model = model
        self._registers = registers
        self._port = port
        self._renamed = renamed or {}
        self._left_out = frozenset(left_out)
        self._nodes: list[ET.Element] = []
        self._categories: dict[str, list[str]] = {}
        self._category = "Root"
        self._selected: dict[str, list[str]] = {}

    def category(self, name: str) -> None:
        """Start a category: the following features belong to it."""
        self._category = name

    def integer(
        self,
        name: str,
        low: object = None,
        high: object = None,
        step: int = 1,
        *,
        length: int = 4,
        by: By | None = None,
        locked: bool = False,
    ) -> None:
        """An integer; read-only without limits. A limit may be the name of another node."""
        if not self._included(name):
            return
        register = self._register("IntReg", name, length, by, read_only=low is None, sign=True)
        limits: list[Child] = []
        if low is not None:
            limits = [_limit("Min", low), _limit("Max", high), ("Inc", step)]
        self._feature("Integer", name, locked, [("pValue", register), *limits], by)

    def number(
        self,
        name: str,
        low: float | None = None,
        high: float | None = None,
        *,
        unit: str = "",
        by: By | None = None,
        locked: bool = False,
    ) -> None:
        """A floating-point number; read-only without limits."""
        if not self._included(name):
            return
        register = self._register("FloatReg", name, 8, by, read_only=low is None)
        limits: list[Child] = [] if low is None else [("Min", low), ("Max", high)]
        units: list[Child] = [("Unit", unit)] if unit else []
        self._feature("Float", name, locked, [("pValue", register), *limits, *units], by)

    def choice(
        self,
        name: str,
        entries: dict[str, int],
        *,
        by: By | None = None,
        locked: bool = False,
        only_if: dict[str, str] | None = None,
    ) -> None:
        """An enumeration; ``only_if`` names for some entries the node that decides whether they exist."""
        if not self._included(name):
            return
        register = self._register("IntReg", name, 4, by, sign=True)
        node = self._feature("Enumeration", name, locked, [], by)
        at = [child.tag for child in node].index("pSelected") if node.find("pSelected") is not None else len(node)
        for entry, value in entries.items():
            element = ET.Element("EnumEntry", Name=entry, NameSpace="Standard")
            if only_if and entry in only_if:
                ET.SubElement(element, "pIsImplemented").text = only_if[entry]
            ET.SubElement(element, "Value").text = str(value)
            node.insert(at, element)
            at += 1
        value_node = ET.Element("pValue")
        value_node.text = register
        node.insert(at, value_node)

    def switch(self, name: str, *, by: By | None = None, read_only: bool = False, locked: bool = False) -> None:
        """A boolean."""
        if not self._included(name):
            return
        register = self._register("IntReg", name, 4, by, read_only=read_only, sign=True)
        self._feature("Boolean", name, locked, [("pValue", register), ("OnValue", 1), ("OffValue", 0)], by)

    def command(self, name: str, *, by: By | None = None, locked: bool = False) -> None:
        """A command: writing 1 starts it."""
        if not self._included(name):
            return
        register = self._register("IntReg", name, 4, by, sign=True)
        self._feature("Command", name, locked, [("pValue", register), ("CommandValue", 1)], by)

    def text(self, name: str, *, writable: bool = False, length: int = 64) -> None:
        """A string of at most ``length`` bytes."""
        if not self._included(name):
            return
        where = self._registers.address(name, length)
        access = "RW" if writable else "RO"
        children: list[Child] = [("Address", hex(where)), ("Length", length), ("AccessMode", access)]
        self._feature("StringReg", name, False, [*children, ("pPort", self._port)])

    def formula(self, name: str, formula: str, **variables: str) -> None:
        """A hidden integer computed from other nodes."""
        node = self._node("IntSwissKnife", name, [])
        for variable, source in variables.items():
            ET.SubElement(node, "pVariable", Name=variable).text = source
        ET.SubElement(node, "Formula").text = formula

    def chunk(self, name: str, chunk_id: int, *, number: bool = False) -> None:
        """A value of 8 bytes in each image's chunk data."""
        if not self._included(name):
            return
        self._node("Port", f"{name}Port", [("ChunkID", f"{chunk_id:X}")])
        children: list[Child] = [("Address", 0), ("Length", 8), ("AccessMode", "RO"), ("pPort", f"{name}Port")]
        children += [("Cachable", "NoCache")]
        children += [] if number else [("Sign", "Unsigned")]
        self._node("FloatReg" if number else "IntReg", f"{name}Reg", [*children, ("Endianess", "LittleEndian")])
        self._feature("Float" if number else "Integer", name, False, [("pValue", f"{name}Reg")])

    def xml(self) -> str:
        """The description as XML."""
        root = ET.Element(
            "RegisterDescription",
            ModelName=self._model,
            VendorName="Fringed",
            ToolTip="emulated camera",
            StandardNameSpace="None",
            SchemaMajorVersion="1",
            SchemaMinorVersion="1",
            SchemaSubMinorVersion="0",
            MajorVersion="1",
            MinorVersion="0",
            SubMinorVersion="0",
            ProductGuid="6f1d2a54-30c7-4b0e-9a55-8a2b0c7d1e01",
            VersionGuid="6f1d2a54-30c7-4b0e-9a55-8a2b0c7d1e02",
            xmlns=_SCHEMA,
        )
        for category, features in (("Root", list(self._categories)), *self._categories.items()):
            element = ET.SubElement(root, "Category", Name=category, NameSpace="Standard")
            for feature in features:
                ET.SubElement(element, "pFeature").text = feature
        root.extend(self._nodes)
        ET.SubElement(root, "Port", Name=self._port, NameSpace="Standard")
        for selector, selected in self._selected.items():
            node = next(node for node in self._nodes if node.get("Name") == selector)
            for feature in selected:
                ET.SubElement(node, "pSelected").text = feature
        ET.indent(root, " ")
        return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"

    def _included(self, name: str) -> bool:
        return name not in self._left_out

    def _register(
        self, kind: str, name: str, length: int, by: By | None, *, read_only: bool = False, sign: bool = False
    ) -> str:
        """The register's node; never cached, as the camera rounds values and other programs may have set them."""
        where = self._registers.address(name, length, by.count if by else 1)
        children: list[Child] = [("Address", hex(where))]
        node_name = f"{self._renamed.get(name, name)}Reg"
        tail: list[Child] = [("Length", length), ("AccessMode", "RO" if read_only else "RW"), ("pPort", self._port)]
        tail += [("Cachable", "NoCache")]
        tail += [("Sign", "Unsigned")] if sign else []
        node = self._node(kind, node_name, children)
        if by:
            ET.SubElement(node, "pIndex", Offset=str(length)).text = f"{by.selector}Reg"
        for tag, value in [*tail, ("Endianess", "LittleEndian")]:
            ET.SubElement(node, tag).text = str(value)
        return node_name

    def _feature(self, kind: str, name: str, locked: bool, children: list[Child], by: By | None = None) -> ET.Element:
        shown = self._renamed.get(name, name)
        self._categories.setdefault(self._category, []).append(shown)
        if by:
            self._selected.setdefault(by.selector, []).append(shown)
        lock: list[Child] = [("pIsLocked", "TLParamsLocked")] if locked else []
        node = self._node(kind, shown, [("Visibility", "Beginner"), *lock, *children])
        node.set("NameSpace", "Standard")
        return node

    def _node(self, kind: str, name: str, children: list[Child]) -> ET.Element:
        node = ET.Element(kind, Name=name)
        for tag, value in children:
            ET.SubElement(node, tag).text = str(value)
        self._nodes.append(node)
        return node


def _limit(tag: str, value: object) -> Child:
    return (f"p{tag}", value) if isinstance(value, str) else (tag, value)
