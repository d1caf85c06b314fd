"""Was Psi learned: an estimate against the truth, online and with frozen weights, where it learned and elsewhere.

recording -> subject (robot, rows, learner) -> psi (online, frozen, held out), excitation, rate -> judgement, all of it
"""
