"""Plug-ins that are files of native code: where they may lie to run without a word, and what the others need."""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path

import pytest

from world.errors import PluginError, UntrustedError
from world.plugins.loading import admit, load_class
from world.plugins.trust import Permission, Trust, permitted_file, trusting

BECAUSE = "a log names it"


@pytest.fixture
def own(tmp_path: Path) -> Path:
    folder = tmp_path / "own"
    (folder / "units").mkdir(parents=True)
    (folder / "units/auv.fmu").write_bytes(b"native code")
    return folder


def test_a_file_below_a_folder_of_the_user_runs(own: Path) -> None:
    admit("plant", "fmu:units/auv.fmu", Permission(own=(own,)))
    assert permitted_file("plant", "fmu:units/auv.fmu") == own / "units/auv.fmu"


@pytest.mark.parametrize("name", ["units/auv.fmu", "{own}/units/auv.fmu", "../own/units/auv.fmu"])
def test_one_that_lies_elsewhere_needs_trust(name: str, own: Path, tmp_path: Path) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    plant = "fmu:" + name.format(own=own)
    with pytest.raises(UntrustedError, match=rf"would run .*auv.fmu, which is not installed, and {BECAUSE}"):
        admit("plant", plant, Permission(own=(mine,), elsewhere=(own,), because=BECAUSE))
    with pytest.raises(UntrustedError, match="nobody allowed it"):
        permitted_file("plant", plant)
    told: list[str] = []
    digest = hashlib.sha256(b"native code").hexdigest()
    trust = Trust(fingerprints=frozenset([digest]), notify=told.append)
    with trusting(trust):
        admit("plant", plant, Permission(own=(mine,), elsewhere=(own,)))
    assert permitted_file("plant", plant) == own / "units/auv.fmu"
    assert len(told) == 1 and "as --trust allows" in told[0]


@pytest.mark.parametrize("open_to_all", ["units", "units/auv.fmu"])
def test_one_that_everybody_may_change_needs_trust(open_to_all: str, own: Path) -> None:
    (own / open_to_all).chmod(0o777)
    with pytest.raises(UntrustedError, match=f"everybody may write into .*{open_to_all}"):
        admit("plant", "fmu:units/auv.fmu", Permission(own=(own,)))


def test_one_with_another_content_is_not_the_one_that_is_trusted(own: Path) -> None:
    trust = Trust(fingerprints=frozenset([hashlib.sha256(b"other code").hexdigest()]))
    with pytest.raises(UntrustedError, match="--trust runs it"), trusting(trust):
        admit("plant", "fmu:units/auv.fmu", Permission(elsewhere=(own,)))


@pytest.mark.parametrize("name", ["nowhere.fmu", "units"])
def test_a_file_that_is_not_there(name: str, own: Path) -> None:
    with pytest.raises(PluginError, match=f"there is no file {name}; it must lie beside the scenario"):
        admit("plant", f"fmu:{name}", Permission(own=(own,)))


def _folder_of_laws(folder: Path, value: int) -> Permission:
    folder.mkdir()
    (folder / "namesake.py").write_text("from namesake_helper import VALUE\n\n\nclass Law:\n    value = VALUE\n")
    (folder / "namesake_helper.py").write_text(f"VALUE = {value}\n")
    return Permission(own=(folder,))


def test_a_scenario_has_the_module_beside_it_and_not_its_namesake_beside_another(tmp_path: Path) -> None:
    folders = {value: _folder_of_laws(tmp_path / str(value), value) for value in (1, 2)}
    stranger = Permission(elsewhere=_folder_of_laws(tmp_path / "3", 3).own)
    for value in (1, 2, 2, 1):
        admit("agent", "namesake:Law", folders[value])
        law = load_class("agent", "namesake:Law", lambda _: None)
        assert law.value == value
        assert [str(path) for path in sys.path if path.startswith(str(tmp_path))] == [str(folders[value].own[0])]
        with pytest.raises(UntrustedError):
            admit("agent", "namesake:Law", stranger)
        assert load_class("agent", "namesake:Law", lambda _: None) is law
        for name in ("namesake", "namesake_helper") if value == 2 else ():  # its folder is on the path still
            del sys.modules[name]
