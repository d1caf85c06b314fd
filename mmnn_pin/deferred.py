"""Machine code only for what Python calls, once; all other compiled functions are kept as what LLVM reads.

numba by itself optimises every function, makes machine code of it with a way in from Python, and does so again inside
each function that calls it: a leaf six calls deep was compiled seven times. Here a function that compiled code calls
is typed and lowered, and waits. One that Python calls is linked with all that it needs, optimised and compiled, once;
so is one that waited, should Python call it later. Both are kept in the cache on disk.

This stands on numba's extension points (a compiler's pipeline, a dispatcher, a cache) and on the library class under
them, which is not a public one; where a version of numba lacks what is used, `DEFERS` is False and numba does as ever.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from threading import Timer
from typing import Any

from llvmlite import binding as llvm
from numba.core import compiler, environment, typed_passes
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import register_pass
from numba.core.registry import CPUDispatcher

USED = ("_get_module_for_linking", "_finalize_final_module", "enable_object_caching")
DEFERS = all(hasattr(JITCodeLibrary, name) for name in USED) and hasattr(typed_passes, "NativeLowering")
ENVIRONMENT = "_ZN08NumbaEnv"
PATIENCE = 1.5  # [s] that Python waits for machine code before `waiting` is called
waiting: list[Callable[[str], None]] = []  # each is given the name of the function that is being compiled


def linkable(library: Any) -> llvm.ModuleRef:
    """A library's functions and all that they call, as a module that can be linked into many, not optimised."""
    if library._shared_module is None:
        if library._finalized and not isinstance(library, Library):
            return library._get_module_for_linking()
        if getattr(library, "bitcode", None) is not None:
            library._shared_module = llvm.parse_bitcode(library.bitcode)
            return library._shared_module
        module = library._final_module.clone()
        link(module, library._linking_libraries)
        for function in module.functions:
            if not function.is_declaration and function.linkage == llvm.Linkage.external:
                function.linkage = "linkonce_odr"
        library._shared_module = module
    return library._shared_module


def link(module: llvm.ModuleRef, libraries: Iterable[Any]) -> None:
    """Link libraries into a module, each once."""
    for library in dict.fromkeys(libraries):
        module.link_in(linkable(library), preserve=True)


class Library(JITCodeLibrary):
    """The code of a function. `finalize`, which optimises it and makes machine code, comes late or never."""

    def add_linking_library(self, library: Any) -> None:
        """Note a library that functions of this one call; unlike numba's, it need not be machine code."""
        self._linking_libraries.append(library)

    def _get_module_for_linking(self) -> llvm.ModuleRef:
        return linkable(self)

    def _optimize_functions(self, ll_module: llvm.ModuleRef) -> None:
        ll_module.data_layout = self._codegen._data_layout
        builder = self._codegen._pass_builder()
        passes = llvm.create_new_module_pass_manager()
        passes.add_sroa_pass()
        passes.add_simplify_cfg_pass()
        passes.add_dead_code_elimination_pass()
        passes.add_global_dead_code_eliminate_pass()
        passes.run(ll_module, builder)

    def _optimize_final_module(self) -> None:
        passes, builder = self._codegen._module_pass_manager()
        passes.run(self._final_module, builder)

    def finalize(self) -> None:
        """Link, optimise, make machine code."""
        link(self._final_module, self._linking_libraries)
        self._optimize_final_module()
        self._final_module.verify()
        self._finalize_final_module()

    @property
    def has_dynamic_globals(self) -> bool:
        """Whether there are addresses of this process in it, which cannot be cached."""
        return any(v.name.startswith("numba.dynamic.globals") for v in linkable(self).global_variables)


class Entry:
    """The way from Python into a function, whose machine code is made when it is asked for."""

    def __init__(self, context: Any, library: Library, fndesc: Any, env: Any) -> None:
        self.context, self.library, self.fndesc, self.env = context, library, fndesc, env
        self.machine_code: tuple[bytes, tuple[Any, ...]] | None = None  # with the environments that it knows
        self.function: Callable[..., Any] | None = None

    def __call__(self, *args: Any) -> Any:
        """Call the function."""
        return self.executable()(*args)

    @global_compiler_lock
    def executable(self) -> Callable[..., Any]:
        """The function as Python's."""
        if self.function is None:
            library = Library(self.context.codegen(), self.library.name)
            library.enable_object_caching()
            library.add_linking_library(self.library)
            codegen = self.context.codegen()
            if self.machine_code is None:
                with self.context.push_code_library(library):
                    self.context.create_cpython_wrapper(library, self.fndesc, self.env, None, release_gil=True)
                library.finalize()
                self.machine_code = library._get_compiled_object(), environments(library._final_module)
            else:
                library._set_compiled_object(self.machine_code[0])
                library._finalize_final_module()
                codegen._engine._defined_symbols.add(self.fndesc.llvm_cpython_wrapper_name)
            for env in self.machine_code[1]:
                codegen.set_env(env.env_name, env)
            self.function = self.context.get_executable(library, self.fndesc, self.env)
        return self.function


@register_pass(mutates_CFG=True, analysis_only=False)
class Lowering(typed_passes.NativeLowering):
    """Makes what LLVM reads of a function, and no machine code."""

    _name = "deferred_lowering"

    def run_pass(self, state: Any) -> bool:
        """Lower."""
        state.library = Library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = state.flags.no_cpython_wrapper = state.flags.no_cfunc_wrapper = True
        super().run_pass(state)
        lowered = state.cr
        entry = Entry(state.targetctx, state.library, lowered.fndesc, lowered.env)
        state.targetctx.insert_user_function(entry, lowered.fndesc, [state.library])
        state.cr = lowered._replace(cfunc=entry)
        return True


class Pipeline(compiler.CompilerBase):
    """numba's passes, with `Lowering` in the place of its own."""

    def define_pipelines(self) -> list[Any]:
        """The only pipeline."""
        passes = compiler.DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [(Lowering if p is typed_passes.NativeLowering else p, text) for p, text in passes.passes]
        passes.finalize()
        return [passes]


class Kept(CompileResultCacheImpl):
    """What is kept on disk of a compiled function: what LLVM reads, and the machine code if it was made."""

    def reduce(self, cres: Any) -> tuple[Any, ...]:
        """What is written."""
        entry, module, again = cres.entry_point, linkable(cres.library), tuple(reloaded(cres.library))
        cres.fndesc.typemap = cres.fndesc.calltypes = None  # as numba does: they may not be picklable
        code = module.as_bitcode()
        return code, entry.machine_code, cres.library.name, cres.fndesc, cres.environment, cres.signature, again

    def rebuild(self, target_context: Any, payload: tuple[Any, ...]) -> Any:
        """The compiled function."""
        code, machine_code, name, fndesc, env, signature, again = payload
        for function in again:
            function()
        library = Library(target_context.codegen(), name)
        library.bitcode, library._reload_init = code, set(again)
        entry = Entry(target_context, library, fndesc, env)
        entry.machine_code = machine_code
        return compiler.compile_result(
            target_context=target_context,
            typing_context=target_context.typing_context,
            library=library,
            environment=env,
            entry_point=entry,
            fndesc=fndesc,
            signature=signature,
            objectmode=False,
            lifted=(),
            reload_init=list(again),
        )


class Cache(FunctionCache):
    """The cache of one function."""

    _impl_class = Kept


class Dispatcher(CPUDispatcher):
    """A compiled function: what it is for Python, and for other compiled functions."""

    def __init__(self, py_func: Any, locals: Any = None, targetoptions: Any = None, pipeline_class: Any = None) -> None:
        super().__init__(py_func, locals, targetoptions, pipeline_class=Pipeline)

    def enable_caching(self) -> None:
        """Use the cache on disk."""
        self._cache = Cache(self.py_func)

    def add_overload(self, cres: Any) -> None:
        """Note a compiled signature; Python's way in follows when it is first gone."""
        self.overloads[tuple(cres.signature.args)] = cres

    def _compile_for_args(self, *args: Any, **kws: Any) -> Callable[..., Any]:
        """What Python calls with arguments of these types, which it has not called before."""
        with patient(self.__name__):
            return self.for_python(super()._compile_for_args(*args, **kws))

    @global_compiler_lock
    def for_python(self, entry: Any) -> Callable[..., Any]:
        """Make the machine code of an entry and keep it, unless that was done."""
        if not isinstance(entry, Entry):  # a literal was asked for, and this has been here before
            return entry
        is_kept, is_known = entry.machine_code is not None, entry.function is not None
        function = entry.executable()
        cres = next(cres for cres in self.overloads.values() if cres.entry_point is entry)
        if not is_known:
            self._insert([kind._code for kind in cres.signature.args], function, False)
        if not is_kept:
            self._cache.save_overload(cres.signature.args, cres)
        return function

    def prepare(self, *args: Any) -> None:
        """Compile for arguments of these types, for other compiled functions to call."""
        with patient(self.__name__):
            self.compile(tuple(self.typeof_pyval(arg) for arg in args))


@contextmanager
def patient(name: str) -> Iterator[None]:
    """Let Python collect its garbage rarely meanwhile, of which numba makes much; and say so if it takes long."""
    before, timers = gc.get_threshold(), [Timer(PATIENCE, tell, (name,)) for tell in waiting]
    gc.set_threshold(50_000, *before[1:])
    try:
        for timer in timers:
            timer.daemon = True
            timer.start()
        yield
    finally:
        gc.set_threshold(*before)
        for timer in timers:
            timer.cancel()


def environments(module: llvm.ModuleRef) -> tuple[Any, ...]:
    """The environments (globals and constants in Python) of a module's functions."""
    names = (v.name for v in module.global_variables if v.name.startswith(ENVIRONMENT) and not v.is_declaration)
    known = (environment.lookup_environment(name) for name in names)
    return tuple(env for env in known if env is not None and env.can_cache())


def reloaded(library: Any) -> set[Any]:
    """What must run before code from the disk is used."""
    return set().union(library._reload_init, *(reloaded(other) for other in library._linking_libraries))
