"""Functions that are compiled once and called by their address: what needs numba's insides, and can be left out.

numba's own way is to take the code of every function into its callers, and to optimise all of it again at every level:
a first run takes twice as long (docs/explanation/performance.md). Here the callers of a function find it by a name.
Where numba's insides are others than these, or `MMNN_PLAIN_NUMBA=1` is set, `compiled` does without this module.
"""

from __future__ import annotations

import hashlib
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from functools import cached_property, partial
from importlib import import_module
from operator import attrgetter
from pickle import UnpicklingError
from typing import Any

import numba
from llvmlite.binding import add_symbol
from numba.core.caching import IndexDataCacheFile
from numba.core.codegen import JITCodeLibrary
from numba.core.registry import CPUDispatcher
from numba.core.typing.templates import AttributeTemplate as AttributeTemplate

from ..parts import spelled

# Compiled functions allocate nothing; without numba's reference counts they run up to 1.5 times faster and compile in
# less time. One that does allocate fails to compile, loudly.
LEAN: dict[str, Any] = {"_nrt": False, "no_cfunc_wrapper": True}
UNREADABLE = EOFError, UnpicklingError, ImportError, AttributeError  # cut off, or of code that is no more


class Face(JITCodeLibrary):
    """Stands for a function that is called by its address: there is no code in it."""

    def finalize(self) -> None:
        """Nothing is compiled."""
        self._shared_module, self._finalized = self._final_module, True


class OwnNames(IndexDataCacheFile):
    """numba's cache files of a function, the code for each signature under a name of its own.

    numba numbers them. Of two processes that compile at the same time each may give one number to another signature,
    and then a run calls code that was made for other arguments, and crashes. Where one overwrites what the other has
    entered in the index, that is compiled once more. A file that a crash left empty or cut off, or that names a type
    that is no more, counts as none, and code
    that does not fit on the disk is not kept.
    """

    def save(self, key: Any, data: Any) -> None:
        """Keep code; first itself, then its name."""
        with suppress(OSError):
            self._keep(key, data)

    def _keep(self, key: Any, data: Any) -> None:
        entries = self._load_index()
        name = entries.get(key) or self._data_name(int(hashlib.sha256(self._dump(key)).hexdigest()[:15], 16))
        self._save_data(name, data)
        self._save_index(entries | {key: name})

    def load(self, key: Any) -> Any:
        """The compilation that is kept under a key; None where nothing is, or nothing that can be read."""
        try:
            return super().load(key)
        except (OSError, *UNREADABLE):
            return None

    def _load_index(self) -> dict[Any, str]:
        try:
            return dict(super()._load_index())
        except UNREADABLE:
            return {}


def prepare(dispatcher: Any, by_address: bool, from_python: bool) -> None:
    """Make what numba has made of a function one that is called by its address, its cache files safe.

    Args:
        dispatcher: numba's.
        by_address: Whether callers find it by its address; else they take its code in.
        from_python: Whether Python often calls it.
    """
    dispatcher.add_overload = partial(publish if by_address else remember, dispatcher)
    if hasattr(dispatcher._cache, "_cache_file"):
        dispatcher._cache._cache_file.__class__ = OwnNames
    if not from_python:
        dispatcher.__class__ = Internal


class Internal(CPUDispatcher):
    """A function compiled for compiled callers; called from Python, it compiles a caller for itself."""

    def __call__(self, *args: Any) -> Any:
        """Call it from Python."""
        return self.caller(*args)

    @cached_property
    def caller(self) -> Any:
        """The function, for Python."""
        given = ", ".join(self.py_func.__code__.co_varnames[: self.py_func.__code__.co_argcount])
        call = spelled(f"def call({given}): return function({given})", function=self)
        return numba.njit(nogil=True, error_model="numpy", **LEAN)(call)


def remember(dispatcher: Any, compilation: Any) -> None:
    """Enter a compilation; from the cache it no longer says what is made ready before it, which its callers have to."""
    compilation.library._reload_init.update(compilation.reload_init)
    type(dispatcher).add_overload(dispatcher, compilation)


@dataclass(frozen=True)
class LinkedLoader:
    """Makes a linked function ready before code that calls it, which comes from the cache."""

    module: str
    name: str
    types: tuple[Any, ...]

    def __call__(self) -> None:
        """Compile the function for these types, or take it from the cache."""
        attrgetter(self.name)(import_module(self.module)).compile(self.types)


def publish(dispatcher: Any, compilation: Any) -> None:
    """Enter what numba has compiled for some types under a name of its own, by which compiled callers find it."""
    remember(dispatcher, compilation)
    target, types, library = dispatcher.targetctx, compilation.signature.args, compilation.library
    fndesc = copy(compilation.fndesc)
    load = LinkedLoader(fndesc.modname, fndesc.qualname, types)
    given = str([(getattr(kind, "instance_class", None), kind) for kind in types])  # numba says no more than its name
    name = f"{load.module}.{load.name}.{hashlib.sha256(given.encode()).hexdigest()[:16]}"
    add_symbol(name, library.get_pointer_to_function(fndesc.llvm_func_name))
    fndesc.mangled_name = name
    face = Face(target.codegen(), name)
    face._reload_init.add(load)
    target.remove_user_function(compilation.entry_point)
    target.insert_user_function(compilation.entry_point, fndesc, [face])
