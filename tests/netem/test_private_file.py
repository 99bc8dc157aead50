"""Files with secrets: read if nobody else can, and refused with the place of the mistake."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import msgspec
import pytest
from refusals import check_refusals

from netem.files import DamagedFile, ExposedFile, parse_json, read_private
from netem.whole_file import whole_file, write_whole


class Known(msgspec.Struct):
    name: Annotated[str, msgspec.Meta(max_length=5)]
    count: Annotated[int, msgspec.Meta(ge=1)] = 1
    users: dict[str, tuple[str, str]] = {}  # msgspec copies it


def test_what_it_says() -> None:
    assert parse_json(b'{"name": "a", "other": 1}', Known) == Known("a")


def test_what_is_refused() -> None:
    check_refusals("netem/private files", lambda text: parse_json(text.encode(), Known))
    with pytest.raises(DamagedFile):
        parse_json(('{"users": ' + '{"a":' * 100_000).encode(), Known)


def test_who_may_read_it(tmp_path: Path) -> None:
    path = tmp_path / "secret"
    path.write_bytes(b"x")
    for mode in (0o640, 0o604, 0o620, 0o601):
        path.chmod(mode)
        with pytest.raises(ExposedFile, match=f"mode 0{mode:o}, expected 0600.: chmod 600 {path}"):
            read_private(path, 10)
    path.chmod(0o600)
    assert read_private(path, 1) == b"x"
    with pytest.raises(OSError, match="larger"):
        read_private(path, 0)
    os.mkfifo(tmp_path / "pipe", 0o600)
    with pytest.raises(OSError, match="it is a pipe"):
        read_private(tmp_path / "pipe", 10)


def test_another_user_s_link_leads_nothing_of_mine_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither in the place of the part, whose name is drawn, nor in the place of the file."""
    mine = tmp_path / "private"
    mine.write_bytes(b"mine")
    out = tmp_path / "report.html"
    for name in ("report.part.html", ".report.part.html", "report.html.part"):
        (tmp_path / name).symlink_to(mine)
    with whole_file(out) as part:
        assert part.parent == tmp_path and part.suffix == ".html"
        part.write_bytes(b"page")
    out.unlink()
    out.symlink_to(mine)
    if os.getuid() == 0:
        os.chown(out, 4711, -1, follow_symlinks=False)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    write_whole(out, b"page")
    assert (mine.read_bytes(), out.read_bytes(), out.is_symlink()) == (b"mine", b"page", False)


def test_a_link_of_mine_stays_one(tmp_path: Path) -> None:
    there, out = tmp_path / "there", tmp_path / "out"
    out.symlink_to(there)
    write_whole(out, b"page", 0o644)
    assert out.is_symlink() and there.read_bytes() == b"page"


def test_a_small_file_is_on_the_disk_before_it_has_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out, seen = tmp_path / "out", list[tuple[str, bool]]()
    monkeypatch.setattr(os, "fsync", lambda file: seen.append((os.readlink(f"/proc/self/fd/{file}"), out.exists())))
    write_whole(out, b"x")
    (part, early), (folder, late) = seen
    assert Path(part).parent == tmp_path and not early
    assert (Path(folder), late) == (tmp_path, True)
