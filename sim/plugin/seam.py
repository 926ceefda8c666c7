"""Seam: Waterline as an engine plugin of MuJoCo.

MuJoCo calls a plugin's functions for each model that names it. `init` runs for the compiler's own
test step, for each MjData and for each copy of one: it reads the model, refuses it with all that is
wrong, and gives the MjData its *home* (`native.HOME`). Everything that happens in a step is C code
(`native`); Python runs when a model is compiled, a state is made, or a changed model is reset.
"""

import atexit
import copy
import ctypes
import sys
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from functools import cache
from threading import Thread, Timer, local
from typing import TypeVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.kernels import CFunction, when_compiling
from sim.mjcf.checks import check_physics
from sim.mjcf.faults import Faults, ModelError, Note, say
from sim.mjcf.floats import first_state
from sim.mjcf.notes import notes_about, notes_about_places
from sim.mjcf.reading import read_model
from sim.plugin import native
from sim.plugin.context import Context, Contexts, mujoco_library
from sim.plugin.gauge import GAUGED, gauge_at
from sim.plugin.homes import Homes
from sim.plugin.layout import declared, offsets, take_over
from sim.plugin.picture import draw_at

Array = NDArray[np.float64]
Result = TypeVar("Result")

NAME = "waterline"
"""Of the plugin, as MJCF files have it."""

INSTANCE = "water"
"""The name of the instance in the scenes of this project, and where one is added."""

ELEMENT = f'<extension><plugin plugin="{NAME}"><instance name="{INSTANCE}"/></plugin></extension>'
"""What makes a model float that has a tuple 'buoyant'."""

GAUGE = "waterline.gauge"
"""The name of the sensor (see `gauge`)."""

SENSOR, PASSIVE = 1 << 1, 1 << 2
"""mjPLUGIN_SENSOR and mjPLUGIN_PASSIVE: what a plugin can do."""

POSITIONS = 1
"""mjSTAGE_POS: when sensors are read."""

ROOM = 400
"""Characters of reasons that MuJoCo's errors have room for."""

PATIENCE = 2.0
"""Seconds of compiling from which on it is said."""

ADDRESS, INTEGER = ctypes.c_void_p, ctypes.c_int
WORD = ctypes.c_int64


class Plugin(ctypes.Structure):
    """MuJoCo's mjpPlugin (`mujoco/mjplugin.h`), the same in 3.17 and 4.0."""

    _fields_ = (
        ("name", ctypes.c_char_p),
        ("attribute_count", INTEGER),
        ("attributes", ADDRESS),
        ("capabilities", INTEGER),
        ("stage", INTEGER),
        *(
            (name, ADDRESS)
            for name in (
                "nstate", "nsensordata", "init", "destroy", "copy", "reset", "compute", "advance",
                "visualize", "actuator_act_dot", "sdf_distance", "sdf_gradient",
                "sdf_staticdistance", "sdf_attribute", "sdf_aabb",
            )
        ),
    )  # fmt: skip


contexts, homes = Contexts(), Homes()


class _ThreadState(local):
    """is_reading: whether a model is being read, whose helper states need no water; is_compiling:
    whether the next state is that of a model which is being compiled; refusal: why the last model
    of this thread was refused; takes_refusal: whether somebody raises that."""

    is_reading = False
    is_compiling = False
    refusal: BaseException | None = None
    takes_refusal = False


_thread = _ThreadState()


def has_water(model: mujoco.MjModel) -> bool:
    """Whether a model has an instance of the plugin."""
    return _slot(NAME) in model.plugin


def context_of(model: mujoco.MjModel) -> Context:
    """The context of a model. Raises ModelError with all that is wrong with it."""
    with contexts.lock:
        return _found(model._address)[0]


def counted(model: mujoco.MjModel, data: mujoco.MjData, number: int) -> int:
    """A number of `native.HOME` of a state; 0 for one without a home."""
    home = homes.home(data._address, homes.recover(data._address))
    return _word_at(home + 8 * number) if home else 0


def memories_of(model: mujoco.MjModel, data: mujoco.MjData) -> list[Array]:
    """MEMORY rows (N, 12) of all bodies that can move, as a state remembers them: those that count
    first come first."""
    instance = model.plugin.tolist().index(_slot(NAME))
    start = int(model.plugin_stateadr[instance])
    states = data.plugin_state[start : start + int(model.plugin_statenum[instance]) - 1]
    states = np.reshape(states, (-1, native.MEMORY))
    home = homes.home(data._address, homes.recover(data._address))
    if not home:
        return [states]
    numbers = ctypes.c_double * (len(states) * native.KEPT)
    kept = np.array(numbers.from_address(home + native.HOME_SIZE)).reshape(len(states), -1)
    latest, *earlier = np.split(kept, 1 + native.EARLIER, axis=1)
    return [latest, states, *earlier]


@contextmanager
def refusals_raised() -> Iterator[None]:
    """A block in which what this plugin refuses is raised as it is: MuJoCo's own error has no room
    for many faults, and is no Note."""
    before = _thread.takes_refusal
    _thread.takes_refusal, _thread.refusal = True, None
    try:
        yield
    except ValueError as error:
        raise (_thread.refusal or error) from None
    finally:
        _thread.takes_refusal, _thread.refusal = before, None


@contextmanager
def reading() -> Iterator[None]:
    """A block in which states that this thread makes get no water."""
    before, _thread.is_reading = _thread.is_reading, True
    try:
        yield
    finally:
        _thread.is_reading = before


def _found(model: int, like: mujoco.MjModel | None = None) -> tuple[Context, int]:
    """The context of the model at an address, and its content. `like`: a model of the same
    structure, if the one at the address cannot be copied. Raises ModelError."""

    def make() -> Context:
        own = _copy_of(model) if like is None else copy.copy(like)
        if like is not None:
            take_over(own, model)
        return Context(own, read_model(own))

    with _notice_of_compiling():
        try:
            return contexts.of(model, lambda: _apart(make))
        except ModelError as error:
            say(error.notes)
            raise


def _apart(task: Callable[[], Result]) -> Result:
    """What a task returns, or raises, that calls MuJoCo while MuJoCo waits for us: in a thread of
    its own, because each call sets anew where in its thread errors go to."""
    future: Future[Result] = Future()

    def work() -> None:
        try:
            with reading():
                future.set_result(task())
        except BaseException as error:
            future.set_exception(error)

    Thread(target=work, daemon=True, name="reading a model").start()
    return future.result()


def _copy_of(model: int) -> mujoco.MjModel:
    """A copy of the model at an address, for Python's own class."""
    copied = mujoco_library().mj_copyModel
    copied.restype = ADDRESS
    return mujoco.MjModel._from_model_ptr(copied(None, ADDRESS(model)))  # which frees it


def _look_at(model: int, context: Context) -> None:
    """Look at what is a model's own, whatever its context, and say what is likely not meant. Raises
    ModelError."""

    def look() -> list[str]:
        own, faults = _copy_of(model), Faults()
        check_physics(own, faults)
        with faults.collected():
            start = first_state(own)
        faults.refuse()
        sea, floats = context.sea, context.floats
        return [*notes_about(own, sea, floats), *notes_about_places(own, start, sea, floats)]

    say([*context.notes, *_apart(look)])


@contextmanager
def _notice_of_compiling() -> Iterator[None]:
    """Say that kernels are being compiled if that takes long, once in a process."""
    timer = Timer(PATIENCE, _tell)
    timer.daemon = True
    try:
        with when_compiling(timer.start):
            yield
    finally:
        timer.cancel()


@cache
def _tell() -> None:
    text = "waterline: compiling its kernels, which takes a minute or two, once on this machine"
    print(text, file=sys.stderr, flush=True)


@ctypes.CFUNCTYPE(INTEGER, WORD, INTEGER)
def _nstate(model: int, instance: int) -> int:
    """Numbers of the plugin's state: a MEMORY row for each body that can move, and the content.
    Which bodies float is not known yet: MuJoCo asks before it has filled the tuples."""
    _thread.is_compiling = True
    return native.MEMORY * _memories(model) + 1 if _acts(model, instance) else 0


@ctypes.CFUNCTYPE(INTEGER, WORD, WORD, INTEGER)
def _init(model: int, data: int, instance: int) -> int:
    """Give a new MjData its home, and its word in it the number of that; 0 where it needs none. Or
    refuse the model."""
    is_compiling, _thread.is_compiling = _thread.is_compiling, False
    word = _plugin_word(data, instance)
    word.value = 0
    if _thread.is_reading or not _acts(model, instance):
        return 0
    try:
        with contexts.lock:
            context, content = _found(model)
            _join_kernels()
            if is_compiling:
                _look_at(model, context)
            starts = _word_at(model + declared("plugin_stateadr"))
            states = _word_at(data + declared("plugin_state"))
            states += 8 * _integers_at(starts, instance + 1)[instance]
            word.value = homes.add(data, states, context, content, _memories(model))
    except KeyboardInterrupt as interrupt:  # cannot pass through MuJoCo: raised on its other side
        _refused(ModelError(["interrupted"]))
        _thread.refusal = interrupt
        return -1
    except Exception as error:
        return _refused(error)
    return 0


@ctypes.CFUNCTYPE(None, WORD, WORD, WORD)
def _find(model: int, data: int, instance: int) -> None:
    """Put the word of an MjData right which a pickle has overwritten."""
    with contexts.lock:
        _plugin_word(data, instance).value = homes.recover(data)


@ctypes.CFUNCTYPE(None, WORD, WORD)
def _renew(model: int, states: int) -> None:
    """Give the MjData whose plugin has its states at an address, which is being reset, the context
    of its model as that is now. Where that is refused, steps give NaN until it is mended and the
    state reset."""
    with contexts.lock:
        data = homes.data_of(states)
        number = homes.recover(data)
        if number == 0:
            return
        home = homes.home(data, number)
        slots = _integers_at(_word_at(model + declared("plugin")), _count(model, "nplugin"))
        _plugin_word(data, slots.index(_slot(NAME))).value = number
        try:
            before = contexts.at(_word_at(home + 8 * native.CONTEXT_OF))
            context, content = _found(model, like=before.model)
            context.adopt(home, content)
        except Exception as error:
            WORD.from_address(home + 8 * native.REFUSED).value = 1
            _refused(error)


@ctypes.CFUNCTYPE(INTEGER, WORD, INTEGER)
def _no_state(model: int, instance: int) -> int:
    return 0


@ctypes.CFUNCTYPE(INTEGER, WORD, INTEGER, INTEGER)
def _gauged(model: int, instance: int, sensor: int) -> int:
    return GAUGED


@ctypes.CFUNCTYPE(INTEGER, WORD, WORD, INTEGER)
def _init_gauge(model: int, data: int, instance: int) -> int:
    """Refuse a gauge that has no water to read, or no place."""
    if _thread.is_reading:
        return 0
    plugins = _integers_at(_word_at(model + declared("plugin")), _count(model, "nplugin"))
    if _slot(NAME) not in plugins:
        return _refused(
            ModelError([f"the plugin '{GAUGE}' reads the water of '{NAME}': add {ELEMENT}"])
        )
    instances, kinds = (
        _integers_at(_word_at(model + declared(name)), _count(model, "nsensor"))
        for name in ("sensor_plugin", "sensor_objtype")
    )
    site = int(mujoco.mjtObj.mjOBJ_SITE)
    for number, kind in zip(instances, kinds, strict=True):
        if number == instance and kind != site:
            return _refused(
                ModelError([f"the plugin '{GAUGE}' sits on a site: give it objtype=\"site\""])
            )
    return 0


@ctypes.CFUNCTYPE(None)
def _nothing() -> None:
    """Stands for functions that MuJoCo asks for before the kernels have joined."""


def _plugin_word(data: int, instance: int) -> ctypes.c_int64:
    """The word that MuJoCo keeps for an instance in an MjData."""
    return WORD.from_address(_word_at(data + declared("plugin_data")) + 8 * instance)


def _acts(model: int, instance: int) -> bool:
    """Whether an instance is the model's first of this plugin, which acts; others do nothing."""
    slots = _integers_at(_word_at(model + declared("plugin")), instance + 1)
    return slots.index(slots[instance]) == instance


def _memories(model: int) -> int:
    """The number of a model's bodies that can move."""
    bodies = _count(model, "nbody")
    return bodies - _integers_at(_word_at(model + declared("body_weldid")), bodies).count(0)


def _count(model: int, name: str) -> int:
    """One of a model's sizes."""
    return _integers_at(model + declared(name), 1)[0]


def _refused(error: Exception) -> int:
    """What `init` answers for a model that is refused: the reasons go into MuJoCo's own error, as
    many as it has room for; all of them are printed, or raised by `refusals_raised`."""
    if not isinstance(error, ValueError | Note):  # a fault of ours
        traceback.print_exception(error)
        error = RuntimeError(f"{type(error).__name__}: {error}")
    _thread.refusal = error
    faults = list(getattr(error, "faults", (str(error),)))
    shown = [fault for i, fault in enumerate(faults) if len("".join(faults[: i + 1])) < ROOM]
    if not shown:
        shown = [faults[0][:ROOM] + " ..."]
    if len(shown) < len(faults):
        shown.append(f"and {len(faults) - len(shown)} more: see above")
        if not _thread.takes_refusal:
            print("waterline refuses the model:", *faults, sep="\n  ", file=sys.stderr, flush=True)
    text = "\n".join(shown).replace("%", "%%")  # a format of printf
    mujoco_library().mju_warning(text.encode())
    return -1


def _slot(name: str) -> int:
    """A plugin's number among MuJoCo's, -1 before it is registered."""
    slot = INTEGER(-1)
    mujoco_library().mjp_getPlugin(name.encode(), ctypes.byref(slot))
    return slot.value


def _word_at(address: int) -> int:
    return WORD.from_address(address).value


def _integers_at(address: int, count: int) -> list[int]:
    return list((INTEGER * count).from_address(address))


def _address_of(function: ctypes._CFuncPtr) -> int:
    return ctypes.cast(function, ADDRESS).value


def register() -> None:
    """Make the plugin known to MuJoCo. Functions that are kernels join when the first model needs
    them, so that importing the package compiles nothing."""
    water = Plugin(name=NAME.encode(), capabilities=PASSIVE)
    water.nstate, water.init = _address_of(_nstate), _address_of(_init)
    sensor = Plugin(name=GAUGE.encode(), capabilities=SENSOR, stage=POSITIONS)
    sensor.nstate, sensor.init = _address_of(_no_state), _address_of(_init_gauge)
    sensor.nsensordata = _address_of(_gauged)
    for plugin in (water, sensor):
        plugin.reset = plugin.compute = _address_of(_nothing)
        if _slot(plugin.name.decode()) < 0:
            mujoco_library().mjp_registerPlugin(ctypes.byref(plugin))
    with reading():  # compiles a model, which `init` may not, being called by the compiler
        offsets()


@cache
def _join_kernels() -> None:
    """Put the kernels among the functions that MuJoCo calls."""
    for number, name in (
        (native.WORDS, "plugin_data"), (native.INSTANCES, "nplugin"), (native.SLOTS, "plugin")
    ):  # fmt: skip
        native.SEAM[number] = offsets()[name]
    native.SEAM[native.SLOT] = _slot(NAME)
    native.SEAM[native.SLABS] = homes.directory.ctypes.data
    native.SEAM[native.FIND], native.SEAM[native.RENEW] = _address_of(_find), _address_of(_renew)
    known = mujoco_library().mjp_getPluginAtSlot
    known.restype = ctypes.POINTER(Plugin)
    plugin = known(_slot(NAME)).contents
    plugin.reset, plugin.compute = native.reset_at.address, native.compute_at.address
    plugin.copy, plugin.destroy = native.copy_at.address, native.destroy_at.address
    plugin.visualize = draw_at.address
    known(_slot(GAUGE)).contents.compute = gauge_at.address


@atexit.register
def _keep_kernels() -> None:
    """States may end after the interpreter, and what they call must still be there."""
    functions = [each for each in vars(native).values() if isinstance(each, CFunction)]
    for each in (*functions, draw_at, gauge_at, native.SEAM, homes, *contexts):
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(each))


register()
