"""A network for pictures."""

from torch import nn


class Cnn(nn.Module):
    """Two convolutions and two layers behind them."""

    def __init__(self, shape, outputs, options):
        super().__init__()
        channels, height, width = shape
        self.layers = nn.Sequential(
            nn.Conv2d(channels, options.channels, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(options.channels, options.channels, 3, padding=1),
            nn.ReLU(),
            nn.Flatten(),
            nn.Linear(options.channels * height * width, options.width),
            nn.ReLU(),
            nn.Linear(options.width, outputs),
        )

    def forward(self, picture):
        return self.layers(picture)
