"""What a program does while a run trains."""

from eia_sec import Callback


class Harder(Callback):
    """Lengthens the line when it is well covered."""

    def on_progress(self, training):
        if training.reward > -8.0:
            training.set_arguments(size=8)


class Pruning(Callback):
    """Stops a run that has learned nothing by half of its steps."""

    def on_progress(self, training):
        if training.progress > 0.5 and training.reward < -15.0:
            training.stop("no better than random actions")
