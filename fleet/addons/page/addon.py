"""What this add-on offers."""

from __future__ import annotations

from fleet.addon import AddOn, Verb

ADDON = AddOn(
    verbs={
        "Live runs": {
            "view": Verb("fleet.addons.page.verbs.view:view", "Show a live run or a log in the browser."),
        },
        "After a run": {
            "movie": Verb("fleet.addons.page.verbs.movie:movie", "Make a GIF or an MP4 of a log."),
        },
    },
    companions=("fleet.addons.page.companion:PageCompanion",),
    hints={"play": "fleet view (a log on a screen)", **dict.fromkeys(("gui", "dashboard", "ui", "show"), "fleet view")},
)
