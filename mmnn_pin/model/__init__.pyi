from .base.base import Base as Base
from .base.base import Wheel as Wheel
from .base.report import Undecided as Undecided
from .loading import load as load
from .robot import Robot as Robot
from .robots import bundled as bundled
