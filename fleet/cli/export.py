"""The command `fleet export`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import click

from fleet.cli.declare import command
from fleet.cli.exporter import Exporters, Selection
from fleet.cli.log_argument import Log, check_options
from fleet.cli.types import FOLDER, Force, NoProgress
from fleet.mcap.other import other_data
from fleet.option import Option, fields
from fleet.terminal.progress import showing
from fleet.terminal.width import say


@command()
def export(
    log: Log,
    *,
    csv: Annotated[Path | None, FOLDER, Option("Write CSV here.")] = None,
    parquet: Annotated[Path | None, FOLDER, Option("Write Parquet here; needs uuv-fleet[parquet].")] = None,
    netcdf: Annotated[Path | None, FOLDER, Option(
        "Write NetCDF here, by the CF conventions; needs uuv-fleet[tables].")] = None,
    exporters: Exporters,
    scenario: Annotated[bool, Option(
        "Print the scenario that runs LOG again, with all that was injected while it was made.")] = False,
    topics: Annotated[tuple[str, ...], Option(
        "Only topics such as 'uuv/*/state'; repeatable.", "PATTERN")] = (),
    exclude: Annotated[tuple[str, ...], Option("Not these topics; repeatable.", "PATTERN")] = (),
    force: Force = False,
    quiet: NoProgress = False,
) -> None:  # fmt: skip
    """Write LOG (an MCAP file, a run directory, or a bag of ROS 2) as tables, one file per topic, or print its
    scenario; or a study as one table of its runs.

    Times are in s. Units are in CSV's header, and in the metadata of the other formats; export.json describes each
    table. Numbers read back exactly; bytes are hexadecimal in CSV, and left out in NetCDF. Data that only 3D viewers
    need (transforms, scene) are left out. Prints the files.

    \b
    Examples:
      fleet export --csv tables
      fleet export --parquet errors --topics 'uuv/*/error' --topics 'link/*'
      fleet export --netcdf states --topics 'uuv/*/state'
      fleet export runs/latest --traces links
      fleet export tuesday.mcap --traces links --sequence seq
      fleet export runs/latest --ros2 bag
      fleet export studies/rough-sea-20261122-101500 --csv tables
      fleet export --scenario > again.yaml && fleet run again.yaml
    """
    tables = [(form, folder) for form, folder in (("csv", csv), ("parquet", parquet), ("netcdf", netcdf)) if folder]
    others = [each for each in exporters if each.asked]
    places = [*(folder for _, folder in tables), *(each.folder for each in others)]
    folders = [folder.absolute() for folder in places if folder is not None]
    if scenario:
        if folders or topics or exclude:
            raise click.UsageError("--scenario prints the scenario only, and writes no tables")
        _print_scenario(log)
        return
    if not places:
        forms = ", ".join(["--csv DIR", "--parquet DIR", "--netcdf DIR", *(each.form for each in exporters)])
        raise click.UsageError(f"no folder for the tables: give one of {forms}; or --scenario")
    if other := other_data(log):
        names = [name for each in exporters for name in fields(each.options_type)]
        check_options(log, ("netcdf", "topics", "exclude", *names), "logs")
        for form, folder in tables:
            click.echo(other.export(log, folder, form, force=force))
        return
    if (topics or exclude) and not tables and not any(each.selects for each in others):
        all_of_it = ", ".join(each.form for each in others)
        raise click.UsageError(f"--topics and --exclude choose messages, and {all_of_it} writes the whole log")
    if len(set(folders)) < len(folders):
        raise click.UsageError("each form needs a folder of its own: export.json says what is in one")
    for each in others:
        for path in each.write(log, Selection(topics, exclude), force=force):
            click.echo(path)
    if tables:
        _export_tables(log, tables, topics, exclude, force=force)


def _export_tables(
    log: Path, tables: Sequence[tuple[str, Path]], topics: tuple[str, ...], exclude: tuple[str, ...], *, force: bool
) -> None:
    from fleet.logs.export import export as write
    from fleet.logs.open_log import Opening
    from fleet.logs.table import fits

    with showing(f"reading {log}") as on_progress:
        found = Opening(log, topics or None, on_progress, exclude, hold_all=False).read()
    if topics and not len(found):
        but = f" and not like {', '.join(exclude)}" if exclude else ""
        raise click.BadParameter(f"no topic of {log} is like {', '.join(topics)}{but}", param_hint="--topics")
    if found.missing:
        say(f"fleet: {found.path}: {found.missing}", err=True)
    if left := [name for name in found if len(found[name]) and not fits(found[name])]:
        say(f"fleet: left out, being lists of messages and no tables: {', '.join(left)}", err=True)
    for form, folder in tables:
        with showing(f"writing {folder}") as on_progress:
            paths = write(found, folder, form, force=force, share=on_progress)
        for path in paths:
            click.echo(path)


def _print_scenario(log: Path) -> None:
    from fleet.repeat.recorded_run import script

    with showing(f"reading {log}") as on_progress:
        made = script(log, on_progress)
    click.echo(made.to_yaml(), nl=False)
