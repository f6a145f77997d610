"""A task for teams of any size as a plug-in: an environment, and a network with attention over neighbours."""

from crowd.options import AttentionOptions
from eia_sec import Plugin, PluginNetwork

plugin = Plugin(
    networks={"attention": PluginNetwork("crowd.networks:Attention", AttentionOptions)},
    environments={"meet": "crowd.env:Meet"},
)
