"""The kinds of tests, by their files: fast ones, those of an extra, and those that only `.ci/run` asks for."""

from __future__ import annotations

from importlib.util import find_spec

# Pure functions, almost without processes: the loop while editing. Pages, pictures and whole runs are not here.
FAST = (
    *("tests/agents", "tests/netem", "tests/world"),
    *("tests/fleet/checks", "tests/fleet/recorder", "tests/fleet/scenario", "tests/fleet/terminal"),
)
# Files of these folders that make whole runs or processes, or draw many samples: half of the time of the folders.
NOT_FAST = (
    *("tests/agents/test_following.py", "tests/agents/test_localization.py", "tests/agents/test_plugins.py"),
    *("tests/agents/test_trust.py", "tests/netem/test_lives.py", "tests/netem/wire/test_certificate_router.py"),
    *("tests/fleet/scenario/rules/test_plants.py", "tests/fleet/scenario/test_aloha.py"),
    *("tests/fleet/scenario/test_episodes.py", "tests/fleet/scenario/test_sea_trial.py"),
    *("tests/fleet/scenario/test_swarm.py", "tests/fleet/scenario/test_triggers.py"),
    *("tests/world/navigation/test_closed_loop.py", "tests/world/navigation/test_filter.py"),
    *("tests/world/test_realtime.py", "tests/world/test_world_golden.py"),
)
# An extra with the packages that its tests need, and their files. `[test]` installs none of them, `[test-all]` all.
EXTRAS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "cluster": (("dask", "distributed"), ("tests/addons/studies/test_dask_engine.py",)),
    "fmu": (("fmpy",), ("tests/addons/fmu/test_fmu.py", "tests/system/test_fmu_runs.py")),
    "foxglove": (("foxglove", "websockets"), ("tests/addons/page/test_foxglove",)),
    "rl": (("pettingzoo", "gymnasium"), ("tests/addons/learning",)),
    "ros2": (
        ("rosbags", "xxhash", "mcap_ros2", "pyzeros", "zenoh_ros2_sdk"),
        (
            "tests/addons/robots/ros2",
            "tests/addons/robots/test_message_log.py",
            "tests/addons/robots/test_relay_ros2.py",
        ),
    ),
    "view": (
        ("nicegui",),
        (
            *(
                "tests/addons/page/test_page_",
                "tests/addons/page/test_server.py",
                "tests/addons/page/test_words.py",
            ),
            "tests/addons/page/verbs/test_view.py",
        ),
    ),
}
# What is asked once per merge, since it looks at the whole tree, or at what is built from it.
ONCE = (
    "tests/addons/programs",  # they need a compiler, and a minute
    *("tests/house/test_docstrings.py", "tests/house/test_errors.py", "tests/house/test_foreign_project.py"),
    *("tests/house/test_foreign_addon.py", "tests/house/test_lessons.py"),
    *("tests/house/test_rooms.py", "tests/house/test_site.py", "tests/house/test_study_example.py"),
    *("tests/system/test_compiled.py", "tests/system/test_core_alone.py"),
)
# The benchmarks and the paper's claims: a change of the product seldom concerns them.
NIGHTLY = ("tests/benchmarks", "tests/addons/paper")


def extra_of(path: str) -> str:
    """The extra whose tests stand in a file; empty: none."""
    return next((name for name, (_, places) in EXTRAS.items() if path.startswith(places)), "")


def without_packages() -> dict[str, str]:
    """Extras that cannot be tested here, with the first package that is missing."""
    missing = {
        name: next((one for one in needed if find_spec(one) is None), "") for name, (needed, _) in EXTRAS.items()
    }
    return {name: package for name, package in missing.items() if package}
