"""A task with pictures as a plug-in: an environment, and a network that reads them."""

from eia_sec import Plugin, PluginNetwork
from pictures.options import CnnOptions

plugin = Plugin(
    networks={"cnn": PluginNetwork("pictures.networks:Cnn", CnnOptions, reads="image")},
    environments={"lights": "pictures.env:Lights"},
)
