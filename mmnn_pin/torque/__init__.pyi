from .adaptive import Adaptive as Adaptive
from .adaptive import AdaptiveSettings as AdaptiveSettings
from .adaptive_composite import AdaptiveComposite as AdaptiveComposite
from .adaptive_composite import AdaptiveCompositeSettings as AdaptiveCompositeSettings
from .classical import PID as PID
from .classical import PDGravity as PDGravity
from .classical import PIDSettings as PIDSettings
from .concurrent import Concurrent as Concurrent
from .concurrent import ConcurrentSettings as ConcurrentSettings
from .disturbance_observer import DisturbanceObserver as DisturbanceObserver
from .disturbance_observer import DisturbanceObserverSettings as DisturbanceObserverSettings
from .kalman import Kalman as Kalman
from .kalman_settings import KalmanBilinearSettings as KalmanBilinearSettings
from .kalman_settings import KalmanFeaturesSettings as KalmanFeaturesSettings
from .kalman_settings import KalmanFrictionSettings as KalmanFrictionSettings
from .kalman_settings import KalmanRegressorSettings as KalmanRegressorSettings
from .kalman_settings import KalmanResidualSettings as KalmanResidualSettings
from .model_based import PD as PD
from .model_based import ComputedTorque as ComputedTorque
from .model_based import ScheduledPD as ScheduledPD
from .neural import Neural as Neural
from .one_layer import OneLayer as OneLayer
from .two_layer import TwoLayer as TwoLayer
from .two_layer_composite import TwoLayerComposite as TwoLayerComposite
from .two_layer_composite import TwoLayerCompositeSettings as TwoLayerCompositeSettings
from .two_layer_residual import TwoLayerResidual as TwoLayerResidual

__all__: list[str]
