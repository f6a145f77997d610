"""A farm small enough for hand-made checks of the heuristics."""

from dataclasses import replace

from eia_sec.common.config import WorldConfig
from eia_sec.common.config.presets import preset

SMALL = replace(
    preset("eia-sec").farm,
    world=WorldConfig(
        communication_uavs=1,
        monitoring_uavs=2,
        collection_uavs=2,
        field_x=200.0,
        field_y=200.0,
        sensors=100,
        plots_x=10,
        plots_y=10,
        steps=300,
    ),
)
