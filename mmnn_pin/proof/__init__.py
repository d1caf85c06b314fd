"""What a run proves: whether the network learned Psi, whether the Lyapunov function falls, whether the pipeline is right.

recording -> subject (robot, rows, learner) -> psi (was it learned), lyapunov (does V fall, and why not), balance
(does the energy of the errors change as the model says) -> prove, all of it
"""
