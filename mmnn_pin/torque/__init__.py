"""Torque controllers: velocity command and measurement in, generalized torque out.

`controller` has the interface, `law` the step that all engines call, `entries` the list of all controllers. Every
learner is one module, which has its settings, its compiled law and its controller, and one entry in that list; its
classes are named here, in `__init__.pyi`. Its table is in `lab.experiments.learner_tables`. By its entry
`run`, `judge`, the plots and research know it. CONTRIBUTING.md shows how to add one.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # loaded when first used
