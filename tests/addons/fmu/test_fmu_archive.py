"""Archives that are none, that would write elsewhere, or would fill the disk."""

from __future__ import annotations

import stat
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from fleet.addons.fmu import fmu_archive
from fleet.addons.fmu.fmu_archive import DESCRIPTION, archive, platforms, unpack
from netem.limits import FMU, FMU_DESCRIPTION
from world.errors import FmuError


def made(path: Path, files: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as opened:
        for name, data in files.items():
            opened.writestr(name, data)
    return path


def test_only_what_a_run_needs_is_unpacked(tmp_path: Path) -> None:
    files = {DESCRIPTION: b"<a/>", "binaries/linux64/a.so": b"1", "resources/b/c.txt": b"2", "sources/a.c": b"3"}
    path = made(tmp_path / "auv.fmu", files | {"documentation/index.html": b"4"})
    folder = tmp_path / "unpacked"
    unpack(path, folder)
    found = {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    assert found == {name: data for name, data in files.items() if name != "sources/a.c"}
    with archive(path) as opened:
        assert platforms(opened) == ["linux64"]


@pytest.mark.parametrize("name", ["../escaped.so", "/etc/escaped", "binaries/../../escaped", "c:\\escaped", "a\\..\\b"])
def test_a_name_outside_of_the_folder_is_refused(name: str, tmp_path: Path) -> None:
    path = made(tmp_path / "auv.fmu", {DESCRIPTION: b"<a/>", name: b"evil"})
    with pytest.raises(FmuError, match="which lies outside of its folder; do not trust it"):
        unpack(path, tmp_path / "unpacked")
    assert not (tmp_path / "unpacked").exists()


def test_a_link_is_refused(tmp_path: Path) -> None:
    link = zipfile.ZipInfo("resources/link")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    with zipfile.ZipFile(tmp_path / "auv.fmu", "w") as opened:
        opened.writestr(DESCRIPTION, "<a/>")
        opened.writestr(link, "/etc/passwd")
    with pytest.raises(FmuError, match="holds the link 'resources/link'"):
        unpack(tmp_path / "auv.fmu", tmp_path / "unpacked")


def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fmu_archive, "FMU", FMU._replace(bytes=4 << 20))
    path = made(tmp_path / "auv.fmu", {DESCRIPTION: b"<a/>", "resources/zeros": bytes(5 << 20)})
    assert path.stat().st_size < 1 << 20
    with pytest.raises(FmuError, match="would be 5 MiB unpacked: more than 4 MiB are not unpacked"):
        unpack(path, tmp_path / "unpacked")


def test_a_bomb_that_lies_about_its_size_is_not_unpacked_either(tmp_path: Path) -> None:
    path = made(tmp_path / "auv.fmu", {DESCRIPTION: b"<a/>", "resources/zeros": bytes(5 << 20)})
    data = path.read_bytes()
    size = (5 << 20).to_bytes(4, "little")
    assert data.count(size) == 2  # beside the file, and in the directory
    path.write_bytes(data.replace(size, (100).to_bytes(4, "little")))
    with pytest.raises(FmuError, match="is no FMU: Bad CRC-32"):
        unpack(path, tmp_path / "unpacked")
    assert (tmp_path / "unpacked/resources/zeros").stat().st_size <= 100


def test_too_many_files_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fmu_archive, "FMU", FMU._replace(items=3))
    path = made(tmp_path / "auv.fmu", {DESCRIPTION: b"<a/>", **{f"resources/{k}": b"" for k in range(3)}})
    with pytest.raises(FmuError, match="holds 4 files: more than 3 are not unpacked"):
        unpack(path, tmp_path / "unpacked")


def test_a_description_without_end_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fmu_archive, "FMU_DESCRIPTION", FMU_DESCRIPTION._replace(bytes=1 << 20))
    path = made(tmp_path / "auv.fmu", {DESCRIPTION: bytes(2 << 20)})
    with pytest.raises(FmuError, match=r"has a modelDescription.xml of 2 MiB"):
        unpack(path, tmp_path / "unpacked")


@pytest.mark.parametrize(
    ("write", "words"),
    [
        (lambda path: None, "cannot be read: No such file or directory"),
        (lambda path: path.mkdir(), "cannot be read: Is a directory"),
        (lambda path: path.write_bytes(b"no zip at all"), "is no FMU: File is not a zip file; an FMU is a zip file"),
        (lambda path: path.write_bytes(b""), "is no FMU"),
        (lambda path: made(path, {"readme.txt": b""}), r"is no FMU: it has no modelDescription.xml"),
        (lambda path: path.write_bytes(made(path, {DESCRIPTION: bytes(999)}).read_bytes()[:-30]), "is no FMU"),
    ],
)
def test_what_is_no_fmu(write: Callable[[Path], object], words: str, tmp_path: Path) -> None:
    write(tmp_path / "auv.fmu")
    with pytest.raises(FmuError, match=words):
        unpack(tmp_path / "auv.fmu", tmp_path / "unpacked")
