"""The command `fleet list`."""

from __future__ import annotations

import click

from fleet.cli.documents.output import json_option, print_document
from fleet.terminal.table import stdout


@click.command(name="list")
@json_option
def list_(as_json: bool) -> None:
    """List the scenarios that ship with the package, by group, and the studies.

    fleet ls lists the runs made of them, and fleet ps the live ones. The cost of a study is the approximate time of all
    its runs on one processor core, with compiled code.
    """
    from fleet.scenario.catalogue import list_scenarios
    from fleet.study.catalogue import list_studies

    scenarios, studies = list_scenarios(), list_studies()
    if as_json:
        from fleet.cli.documents.listing import ScenarioRow, Scenarios, StudyRow

        print_document(Scenarios([ScenarioRow(*row) for row in scenarios], [StudyRow(*row) for row in studies]))
        return
    from rich.table import Table
    from rich.text import Text

    from fleet.scenario.schema.groups import GROUPS

    terminal = stdout()
    table = Table(box=None, pad_edge=False)
    for heading in ("scenario", "UUVs", "time", "expect", "what one learns"):
        table.add_column(heading, no_wrap=heading != "what one learns")
    for group in GROUPS:
        table.add_row(Text(group, "bold"))
        for row in (row for row in scenarios if row.group == group):
            table.add_row(f"  {row.name}", str(row.vehicles), f"{row.duration_s:g} s", row.expect, row.title)
    terminal.print(table)
    terminal.print()
    table = Table(box=None, pad_edge=False)
    for heading in ("study", "runs", "cost", "what it asks"):
        table.add_column(heading, no_wrap=heading != "what it asks")
    for study in studies:
        table.add_row(study.name, str(study.runs), f"{study.core_s / 60:.0f} min", study.title)
    terminal.print(table)


COMMANDS = (list_,)
