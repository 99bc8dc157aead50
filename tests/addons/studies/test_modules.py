"""The modules of laws that travel to workers of other machines."""

from __future__ import annotations

import sys
from hashlib import sha256
from pathlib import Path
from random import getrandbits

import pytest
from failing_laws import failing
from small_scenario import SMALL

from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.modules import Modules, folder_of, get_ready, modules_of, packed
from fleet.scenario.loading import parse_scenario
from fleet.scenario.trust import Policy


@pytest.fixture
def tag(tmp_path: Path) -> str:
    """What makes the names of the modules of each test others: what was let in once is found later."""
    return f"{getrandbits(40):x}"


@pytest.fixture
def ready(tmp_path: Path, tag: str) -> Modules:
    package = tmp_path / f"package_{tag}"
    package.mkdir()
    (package / "__init__.py").write_text("", "utf-8")
    (package / "law.py").write_text(f"import helper_{tag}\n" + failing(3, "pass"), "utf-8")
    (tmp_path / f"helper_{tag}.py").write_text("GAIN = 1.0\n", "utf-8")
    (tmp_path / f"unused_{tag}.py").write_text("SECRET = 1\n", "utf-8")
    text = f"{SMALL}controller: package_{tag}.law:Law\n"
    scenario = parse_scenario(text, "small.yaml", folder=tmp_path, policy=Policy(stranger=""))
    return packed(modules_of([scenario], tmp_path))


def test_what_a_law_imported_from_its_folder_travels_and_nothing_else(ready: Modules, tag: str) -> None:
    paths = [f"helper_{tag}.py", f"package_{tag}/__init__.py", f"package_{tag}/law.py"]
    assert [path for path, _ in ready.carried] == paths
    assert (ready.names, len(ready.fingerprints), ready.folder) == ((f"package_{tag}.law",), 2, None)


def test_a_worker_writes_them_once(ready: Modules, tag: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in (f"package_{tag}.law", f"package_{tag}", f"helper_{tag}"):
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry != str(tmp_path)])
    folder = folder_of(ready)
    assert (folder / f"package_{tag}" / "law.py").read_text("utf-8").startswith("import helper_")
    assert folder.stat().st_mode & 0o077 == 0
    assert folder_of(ready) == folder
    other = ready._replace(carried=((f"helper_{tag}.py", b"GAIN = 2.0\n"), *ready.carried[1:]))
    assert folder_of(other) != folder


def test_a_module_that_was_changed_replaces_the_one_of_the_study_before(ready: Modules, tag: str) -> None:
    get_ready(ready)
    name, law = f"package_{tag}.law", b"from helper_" + tag.encode() + b" import GAIN\n"
    carried = ((f"helper_{tag}.py", b"GAIN = 2.0\n"), ready.carried[1], (f"package_{tag}/law.py", law))
    prints = tuple(sha256(data).hexdigest() for _, data in carried)
    get_ready(ready._replace(carried=carried, fingerprints=prints))
    assert sys.modules[name].GAIN == 2.0


def test_an_installed_module_of_that_name_is_told(
    ready: Modules, tag: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (package := tmp_path / "installed" / f"package_{tag}").mkdir(parents=True)
    for name in ("__init__.py", "law.py"):
        (package / name).write_text("# another one", "utf-8")
    for name in (f"package_{tag}.law", f"package_{tag}"):
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(sys, "path", [*sys.path[:1], str(package.parent), *sys.path[1:]])
    with pytest.raises(StudyError, match=rf"another module package_{tag} is installed there, .*: restart the worker"):
        folder_of(ready)


def test_a_path_that_leads_elsewhere_is_not_written(ready: Modules) -> None:
    with pytest.raises(ValueError, match="escape"):
        folder_of(ready._replace(carried=(("../escape.py", b""),)))


CHECK = """
from fleet.checks.api import Check
class AtMostOne(Check):
    pass
"""


@pytest.mark.parametrize("beside", [True, False])
def test_the_checks_of_a_stack_are_found_beside_its_file_or_where_the_user_is(
    beside: bool, tag: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A failure that a search has kept lies in a folder of its own, and its checks where the user was."""
    (kept := tmp_path / "kept").mkdir()
    monkeypatch.chdir(tmp_path)
    ((kept if beside else tmp_path) / f"check_{tag}.py").write_text(CHECK, "utf-8")
    text = f'title: A stack\nnodes: {{a: {{}}, b: {{}}}}\nchecks: {{"check_{tag}:AtMostOne": {{}}}}\n'
    scenario = parse_scenario(text, "stack.yaml", folder=kept, policy=Policy(stranger="", imports=False))
    found = modules_of([scenario], kept).folder
    assert found == str((kept if beside else tmp_path).resolve())
    plain = parse_scenario("title: A stack\nnodes: {a: {}, b: {}}\n", "stack.yaml", folder=kept)
    assert modules_of([plain], kept).folder is None
