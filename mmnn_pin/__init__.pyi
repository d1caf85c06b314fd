from .deploy.embed import embed as embed
from .deploy.identify.identification import identify as identify
from .errors import InputError as InputError
from .lab.experiments.compare import compare as compare
from .lab.experiments.config import load_experiment as load_experiment
from .lab.experiments.runner import run_experiment as run_experiment
from .lab.experiments.stepping import stepper_on as stepper_on
from .lab.psi.judgement import judge as judge
from .lab.study.sweep import sweep as sweep
from .loop.driving import DeadReckoning as DeadReckoning
from .loop.driving import drive as drive
from .loop.loop import Loop as Loop
from .loop.stepper import Stepper as Stepper
from .loop.stepper import StepperSettings as StepperSettings
from .model.checks.properties import check as check
from .model.loading import load as load
from .model.robot import Robot as Robot
from .recording.recording import Recording as Recording
from .reference import Circle as Circle
from .reference import Eight as Eight
from .reference import Hold as Hold
from .reference import Line as Line
from .reference import Sine as Sine
from .reference import Trajectory as Trajectory
from .settings import Timing as Timing
from .signals import Measurement as Measurement
from .signals import Setpoint as Setpoint
from .torque.controller import Feedback as Feedback
from .torque.controller import TorqueController as TorqueController
from .torque.learning_law import LearningLaw as LearningLaw
from .torque.model_based import PD as PD
from .torque.neural import Neural as Neural

__all__: list[str]
__version__: str
