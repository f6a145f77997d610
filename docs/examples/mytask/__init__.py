"""A task of one's own as a plug-in: an environment, losses, a heuristic and a callback."""

from eia_sec import Plugin, PluginAlgorithm
from mytask.options import BoldOptions, SmoothOptions

plugin = Plugin(
    algorithms={
        "smooth": PluginAlgorithm("mytask.losses:Smooth", SmoothOptions),
        "bold": PluginAlgorithm("mytask.losses:Bold", BoldOptions),
    },
    heuristics={"nearest": "mytask.heuristics:Nearest"},
    environments={"cover": "mytask.env:Cover"},
    callbacks=["mytask.callbacks:Harder"],
)
