"""Model descriptions of FMUs: what is read of them, and those that are wrong or ask for too much."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest
from refusals import check_refusals
from repository import ROOT
from spawned import python

from fleet.addons.fmu import fmu_archive, fmu_description
from fleet.addons.fmu.fmu_archive import archive
from fleet.addons.fmu.fmu_description import BaseUnit, UnitVariable, parse
from netem.limits import FMU_DESCRIPTION
from world.errors import FmuError

SIMULATION = '<CoSimulation modelIdentifier="m"/>'


def text(variables: str, version: str = "2.0", before: str = SIMULATION) -> bytes:
    return (
        f'<?xml version="1.0"?><fmiModelDescription fmiVersion="{version}" guid="g" instantiationToken="t">{before}'
        f"<ModelVariables>{variables}</ModelVariables><ModelStructure/></fmiModelDescription>"
    ).encode()


def scalar(name: str, inner: str = "<Real/>", reference: str = "1", more: str = "") -> str:
    return f'<ScalarVariable name="{name}" valueReference="{reference}" {more}>{inner}</ScalarVariable>'


def test_of_fmi_2() -> None:
    units = (
        '<UnitDefinitions><Unit name="kN"><BaseUnit kg="1" m="1" s="-2" factor="1000"/></Unit>'
        '<Unit name="degC"><BaseUnit K="1" offset="273.15"/></Unit><Unit name="?"/></UnitDefinitions>'
    )
    types = '<TypeDefinitions><SimpleType name="Force"><Real unit="kN"/></SimpleType></TypeDefinitions>'
    simulation = '<CoSimulation modelIdentifier="m" canGetAndSetFMUstate="true" canSerializeFMUstate="1"/>'
    variables = (
        scalar("F", '<Real declaredType="Force" max="INF"/>', "7", 'causality="input" description="a force"')
        + scalar("n", '<Integer max="8"/><Annotations><Tool name="x"><any/></Tool></Annotations>', "8")
        + scalar("G", '<Real declaredType="Force" unit="N" max="3.5"/>', "9")
    )
    found = parse(text(variables, before=simulation + units + types))
    assert (found.version, found.guid, found.model) == (2, "g", "m")
    assert found.units == {
        "kN": BaseUnit((1, 1, -2), False, 1000.0, 0.0),
        "degC": BaseUnit((0, 0, 0), True, 1.0, 273.15),
    }
    assert found.variables == {
        "F": UnitVariable("F", 7, "Real", "input", "a force", "kN", float("inf")),
        "n": UnitVariable("n", 8, "Integer", "local"),
        "G": UnitVariable("G", 9, "Real", "local", unit="N", largest=3.5),
    }


def test_types_of_fmi_2_that_have_no_unit() -> None:
    types = (
        '<TypeDefinitions><SimpleType name="Init"><Enumeration><Item name="no" value="1"/></Enumeration></SimpleType>'
        '<SimpleType name="Count"><Integer/></SimpleType></TypeDefinitions>'
    )
    variables = scalar("a", '<Enumeration declaredType="Init"/>') + scalar("b", '<Integer declaredType="Count"/>')
    found = parse(text(variables, before=SIMULATION + types))
    assert {name: (one.type, one.unit) for name, one in found.variables.items()} == {
        "a": ("Enumeration", ""),
        "b": ("Integer", ""),
    }


def test_of_fmi_3() -> None:
    types = '<TypeDefinitions><Float64Type name="Force" unit="N"/></TypeDefinitions>'
    variables = (
        '<Float64 name="F" valueReference="1" declaredType="Force" max="2"><Alias name="force"/></Float64>'
        '<Float64 name="v" valueReference="2" unit="m/s"><Dimension start="3"/></Float64>'
        '<Binary name="b" valueReference="3"><Start value="00"/></Binary>'
    )
    found = parse(text(variables, "3.0", SIMULATION + types))
    assert (found.version, found.guid) == (3, "t")
    first = UnitVariable("F", 1, "Float64", "local", unit="N", largest=2.0)
    assert found.variables["F"] == first
    alias = found.variables["force"]  # a variable of its own name
    assert (alias.name, alias.reference, alias.unit) == ("force", 1, "N")
    assert found.variables["v"] == UnitVariable("v", 2, "Float64", "local", unit="m/s", array=True)


def test_one_that_is_wrong_says_what() -> None:
    cases = [
        b"",
        b"<fmiModelDescription fmiVersion='2.0'>",
        b'<?xml version="1.0" encoding="no-such"?><a/>',
        b"<a/>",
        b"<fmiModelDescription/>",
        text(""),
        text("<ScalarVariable/>"),
        text(scalar("a", "")),
        text(scalar("a", reference="-1")),
        text(scalar("a", reference="9" * 5000)),
        text(scalar("a") * 2),
        text(scalar("a", '<Real max="much"/>')),
        text(scalar("a", '<Real declaredType="T"/>')),
        text('<Real name="a" valueReference="1"/>', "3.0"),
        text("<a>" * 100 + "</a>" * 100),
        text(scalar("a", "<b>" * 100 + "</b>" * 100)),
        text(scalar("a"), before='<UnitDefinitions><Unit name="u"><BaseUnit m="x"/></Unit></UnitDefinitions>'),
        b'<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>',
    ]
    check_refusals("plants/descriptions", parse, cases)


def test_too_many_variables_or_elements(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fmu_description, "MAX_VARIABLES", 2)
    with pytest.raises(FmuError, match="has more than 2 variables; export it with fewer"):
        parse(text("".join(map(scalar, "abc"))))
    monkeypatch.setattr(fmu_description, "FMU_DESCRIPTION", FMU_DESCRIPTION._replace(items=5))
    with pytest.raises(FmuError, match="of more than 5 elements"):
        parse(text(scalar("a", "<b/>" * 5)))


@pytest.mark.parametrize("variable", ["<ScalarVariable/>", "<a/>", scalar("same"), scalar("a", "<b/>")])
def test_mistakes_without_end_take_no_longer_than_one(variable: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """100,000 of them took minutes, because each was described with its place among the others."""
    seen: list[str] = []
    start = fmu_description._Description.start

    def counted(reader: fmu_description._Description, tag: str, attributes: dict[str, str]) -> None:
        seen.append(tag)
        start(reader, tag, attributes)

    monkeypatch.setattr(fmu_description._Description, "start", counted)
    with pytest.raises(FmuError):
        parse(text(variable * 100_000))
    assert len(seen) < 10


def test_a_list_of_files_that_is_too_long_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "many.fmu"
    with zipfile.ZipFile(path, "w") as opened:
        for n in range(100):
            opened.writestr(f"resources/{n}", b"")
    monkeypatch.setattr(fmu_archive, "MAX_DIRECTORY_BYTES", 1000)
    with pytest.raises(FmuError, match=r"lists its files in \d+ bytes"), archive(path):
        pass


def test_a_signal_ends_the_reading() -> None:
    """While the XML is parsed, which is native code that calls back."""
    code = """
import os, signal
from fleet.addons.fmu import fmu_description
first = fmu_description._Description.start
def start(self, *args):
    first(self, *args)
    os.kill(os.getpid(), signal.SIGTERM)  # as an operator does, who waits
fmu_description._Description.start = start
def ended(*_):
    raise SystemExit(7)
signal.signal(signal.SIGTERM, ended)
fmu_description.parse(b'<fmiModelDescription fmiVersion="2.0"><a/></fmiModelDescription>')
"""
    assert python("-c", code, cwd=ROOT).returncode == 7
