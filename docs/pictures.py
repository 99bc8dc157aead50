"""Makes the pictures of the pages anew: `python docs/pictures.py [NAME ...]`, such as `stack-border.png`.

The script prints how long each picture took. Without a name it makes all pictures, which takes hours. On two cores
(2026-12-01):

* most pictures take less than a minute
* boundary.png takes 2 min, stack-border.png 5 min, and study-controllers.png 11 min
* study-rate.png takes more than 40 min
* nobody has timed stability-map.png, study-loss-delay.png and study-acoustic.png

Look at a picture before you commit it, and compare the figures on its page. If the page shows the command of its
picture, the script runs that command. Only rooms.svg has a script of its own, benchmarks/rooms.py: a test compares it
with the code.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
BOX = re.compile(r"^```(?:sh|python)\n(.*?)^```\n", re.MULTILINE | re.DOTALL)


def run(command: str, folder: Path) -> str:
    """The output of commands. They may exit with 1, as a run does whose check failed."""
    done = subprocess.run(["bash", "-c", command], cwd=folder, text=True, stdout=subprocess.PIPE, check=False)
    if done.returncode > 1:
        sys.exit(f"{command}\nended with {done.returncode}")
    return done.stdout


def boxes(page: Path) -> list[str]:
    """The commands and the code of a page, box by box."""
    return [box[1] for box in BOX.finditer(page.read_text("utf-8"))]


def study(command: str, picture: str, folder: Path) -> Path:
    """The picture of a study that a command makes. It runs in the checkout, since a stack may run what lies below."""
    run(f"{command} --out {folder}/made", ROOT)
    (made,) = (folder / "made").iterdir()
    run(f"fleet plot {made} --out plots", folder)
    return folder / "plots" / picture


def border_of_page(page: Path, folder: Path) -> Path:
    """The border that the first command `fleet boundary` of a page draws."""
    command = next(box for box in boxes(page) if box.startswith("fleet boundary"))
    return study(command.rstrip(), "border.png", folder)


def border_of_stack(folder: Path) -> Path:
    """The border of the example in the README."""
    found = re.search(r"`(fleet boundary docs/examples/election_stack/[^`]+)`", (ROOT / "README.md").read_text("utf-8"))
    assert found is not None
    return study(found[1], "border.png", folder)


def notebook(picture: str, folder: Path) -> Path:
    """A picture of the page that is a notebook: its code up to the pictures."""
    code = boxes(DOCS / "guide" / "study-example.md")
    end = next(number for number, box in enumerate(code) if "study.plot(" in box)
    (folder / "page.py").write_text("\n".join(code[: end + 1]), "utf-8")
    run(f"{sys.executable} page.py", folder)
    return folder / "loss" / "plots" / picture


def movie(folder: Path) -> Path:
    """partition-heal from above at an angle."""
    run("fleet run partition-heal && fleet movie --view 3d --width 640 --fps 7", folder)
    (found,) = folder.rglob("*.gif")
    return found


def page_at(second: int, folder: Path) -> Path:
    """The page of `fleet view` with partition-heal at a time [s], while its links are cut."""
    from playwright.sync_api import sync_playwright

    directory = run("fleet run partition-heal --quiet", folder).strip()
    command = ["fleet", "view", directory, "--no-open"]
    with subprocess.Popen(command, cwd=folder, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as viewer:
        try:
            assert viewer.stdout is not None
            address = next(found[0] for line in viewer.stdout if (found := re.search(r"http://\S+\?token=\S+", line)))
            with sync_playwright() as driver:
                browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
                tab = browser.new_page(viewport={"width": 1280, "height": 800})
                tab.goto(address)
                tab.locator(".fleet-side tbody td:nth-child(2):text-matches('\\\\d')").first.wait_for()
                tab.locator(".fleet-slider").fill(str(second))
                tab.locator(f".fleet-time:has-text('{second}.0')").wait_for()
                tab.locator(".fleet-slider").blur()  # no ring around it
                tab.wait_for_timeout(2000)  # the camera comes to rest
                tab.screenshot(path=folder / "page.png")
        finally:
            viewer.terminate()
    return folder / "page.png"


def manoeuvres(folder: Path) -> Path:
    """Those of remus100 beside the stored ones of its reference."""
    run(f"{sys.executable} {ROOT / 'tests' / 'support' / 'remus_reference.py'} --picture", folder)
    return DOCS / "background" / "plants-remus.png"


PICTURES: dict[str, Callable[[Path], Path]] = {
    "fleet-view.png": partial(page_at, 23),
    "partition-heal.gif": movie,
    "stack-border.png": border_of_stack,
    "boundary.png": partial(border_of_page, DOCS / "guide" / "boundary.md"),
    "stability-map.png": partial(border_of_page, DOCS / "background" / "linear-stability.md"),
    "guide/study-passed.png": partial(notebook, "passed.png"),
    "guide/study-pairs.png": partial(notebook, "compare-controller-formation_final_m.png"),
    "background/plants-remus.png": manoeuvres,
    **{
        f"background/study-{name}.png": partial(study, f"fleet sweep {name}", "passed.png")
        for name in ("loss-delay", "controllers", "rate", "acoustic")
    },
}


def main(names: list[str]) -> None:
    """Make the pictures with these file names. Without names it makes all."""
    chosen = {name: make for name, make in PICTURES.items() if not names or name.rpartition("/")[2] in names}
    if not chosen:
        sys.exit(f"expected one of {', '.join(name.rpartition('/')[2] for name in PICTURES)}")
    for name, make in chosen.items():
        began = time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            if (made := make(Path(folder))) != DOCS / name:
                shutil.copyfile(made, DOCS / name)
        print(f"{name} {time.monotonic() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
