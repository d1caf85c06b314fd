"""The tables of all learners: keys of an experiment, each with the settings of a learner."""

from __future__ import annotations

from ...settings import Settings
from ...torque.adaptive import AdaptiveSettings
from ...torque.adaptive_composite import AdaptiveCompositeSettings
from ...torque.classical import PIDSettings
from ...torque.concurrent import ConcurrentSettings
from ...torque.extended_state import ExtendedStateSettings
from ...torque.feedforward import FeedforwardSettings
from ...torque.kalman_settings import (
    KalmanBilinearSettings,
    KalmanFeaturesSettings,
    KalmanFrictionSettings,
    KalmanRegressorSettings,
    KalmanResidualSettings,
)
from ...torque.l1_adaptive import L1AdaptiveSettings
from ...torque.learned import LearnedSettings
from ...torque.one_layer import OneLayer
from ...torque.super_twisting import SuperTwistingSettings
from ...torque.time_delay import TimeDelaySettings
from ...torque.two_layer import TwoLayer


class KalmanTables(Settings, frozen=True, kw_only=True):
    """The tables of the learners with a Kalman filter."""

    regressor: KalmanRegressorSettings = KalmanRegressorSettings()
    friction: KalmanFrictionSettings = KalmanFrictionSettings()
    bilinear: KalmanBilinearSettings = KalmanBilinearSettings()
    features: KalmanFeaturesSettings = KalmanFeaturesSettings()
    residual: KalmanResidualSettings = KalmanResidualSettings()


class LearnerTables(Settings, frozen=True, kw_only=True):
    """The tables of all learners, by the keys that the list of controllers says."""

    two_layer: TwoLayer = TwoLayer()
    one_layer: OneLayer = OneLayer()
    pid: PIDSettings = PIDSettings()
    feedforward: FeedforwardSettings = FeedforwardSettings()
    time_delay: TimeDelaySettings = TimeDelaySettings()
    extended_state: ExtendedStateSettings = ExtendedStateSettings()
    l1_adaptive: L1AdaptiveSettings = L1AdaptiveSettings()
    super_twisting: SuperTwistingSettings = SuperTwistingSettings()
    adaptive: AdaptiveSettings = AdaptiveSettings()
    adaptive_composite: AdaptiveCompositeSettings = AdaptiveCompositeSettings()
    concurrent: ConcurrentSettings = ConcurrentSettings()
    kalman: KalmanTables = KalmanTables()
    learned: LearnedSettings = LearnedSettings()
