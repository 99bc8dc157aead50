"""The studies that ship, as a table of `fleet list`."""

from __future__ import annotations

from collections.abc import Sequence

from fleet.addons.studies.catalogue import ListedStudy, list_studies
from fleet.cli.listing import Listing


class Studies(Listing):
    """The studies; the cost is the time of all runs on one core, approximately, with compiled code."""

    key = "studies"
    row = ListedStudy
    headings = ("study", "runs", "cost", "what it asks")

    def rows(self) -> Sequence[ListedStudy]:
        """All of them."""
        return list_studies()

    def cells(self, row: ListedStudy) -> Sequence[str]:
        """A study as it is printed."""
        return row.name, str(row.runs), f"{row.core_s / 60:.0f} min", row.title
