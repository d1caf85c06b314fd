"""The robot: its file audited, its base and arm understood, its Pinocchio model with the motions left to it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # the process of a xacro file needs none
