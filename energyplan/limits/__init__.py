"""What the motors can drive: limits of each side, the check of a trajectory, speed profiles."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, ["feasibility", "motor", "speed"])
