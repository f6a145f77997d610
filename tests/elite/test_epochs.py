"""A coordinator follows the learner's epoch, and reports an alarm while it ignores a lower one."""

from types import SimpleNamespace

from eia_sec.common.config.presets import preset
from eia_sec.common.farm import farm_team
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.epoch_fence import PATIENCE_SECONDS, EpochFence
from eia_sec.common.protocol.messages import MetricMessage, ProgressMessage
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.elite.service import Coordinator, CoordinatorOptions
from tests.system.fleet import until

RUN = "epochs"


def test_a_lower_epoch_is_an_alarm_until_it_is_followed():
    """Metrics name it as long as the higher epoch may come back, and no longer."""
    endpoint, config, clock = free_endpoint(), preset("eia-sec"), SimpleNamespace(now=0.0)
    with Bus.listen(endpoint, "control") as other, Bus.connect(endpoint, "control", wait=10.0) as bus:
        metrics = other.subscribe(keys.METRIC.key(RUN, role="elite", name="elite"), 64)
        progress = other.publish_state(keys.PROGRESS.key(RUN))
        coordinator = Coordinator(CoordinatorOptions(RUN, endpoint, "elite", 1.0), config, farm_team(config.farm), bus)
        coordinator._fence = EpochFence(lambda: clock.now)

        def hear(epoch, condition):
            def heard():
                progress.put(ProgressMessage(epoch, 1, 0, 0, 0, 0, "training").encode())
                coordinator._listen()
                return condition()

            until(heard, f"epoch {epoch}", 20.0)

        def reported():
            metrics.drain()
            coordinator._report()
            sample = until(metrics.poll, "a report", 20.0)
            return MetricMessage.decode(sample.payload).values["alarms"]

        hear(9, lambda: coordinator._now is not None)
        assert reported() == []
        hear(7, lambda: coordinator._fence.alarm)
        assert coordinator._now.epoch == 9
        assert len(alarms := reported()) == 1
        assert "lower epoch" in alarms[0]
        clock.now = PATIENCE_SECONDS + 1.0
        hear(7, lambda: coordinator._now.epoch == 7)
        assert reported() == []
