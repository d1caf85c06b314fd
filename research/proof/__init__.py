"""What a run proves: was Psi learned, does the Lyapunov function fall, is the pipeline right.

recording -> subject (robot, rows, learner) -> psi (was it learned), lyapunov (does V fall, and why not), balance
(does the energy of the errors change as the model says) -> proof, all of it
"""
