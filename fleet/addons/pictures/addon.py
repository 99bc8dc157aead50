"""What this add-on offers."""

from __future__ import annotations

from fleet.addon import AddOn, Verb

ADDON = AddOn(
    verbs={
        "After a run": {
            "plot": Verb("fleet.addons.pictures.verbs.plot:plot", "Draw pictures of logs or of a study."),
            "report": Verb("fleet.addons.pictures.verbs.report:report", "Write one HTML page about logs or a study."),
        }
    },
    names={"plot": "fleet.addons.pictures.gallery"},
    hints={"compare": "fleet report (a page about several logs)"},
)
