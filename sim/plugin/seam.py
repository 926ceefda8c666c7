"""Seam: Waterline as an engine plugin of MuJoCo.

MuJoCo calls a plugin's functions for each model that names it. It calls `init` for the compiler's
test step, for each MjData, and for each copy of an MjData. `init` reads the model, refuses it with
all its faults, and gives the MjData a *home* (`native.HOME`). A step runs only compiled code
(`native`). Python runs only when a model is compiled, when a state is made, and when the state of a
changed model is reset.
"""

import atexit
import copy
import ctypes
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from functools import cache
from threading import Thread
from time import monotonic
from typing import TypeVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.kernels import CFunction, kept_kernels, when_compiling
from sim.mjcf.checks import check_physics
from sim.mjcf.faults import Faults, ModelError
from sim.mjcf.fields import HYDRODYNAMICS, MEMORY
from sim.mjcf.floats import first_state
from sim.mjcf.notes import notes_about, notes_about_positions
from sim.mjcf.reading import read_model
from sim.notes import say
from sim.plugin import native
from sim.plugin.context import Context, Contexts
from sim.plugin.gauge import GAUGE_SIZE, gauge_at
from sim.plugin.homes import Homes
from sim.plugin.layout import declared, offsets, take_over
from sim.plugin.memory import (
    ADDRESS,
    INTEGER,
    WORD,
    callback_address,
    floats_at,
    integers_at,
    mujoco_library,
    word_at,
)
from sim.plugin.picture import draw_at
from sim.plugin.refusals import reading, refused, thread
from sim.plugin.response import FIRST_STATE, respond_at
from sim.resistance.hydrodynamics import COLUMN_SIZE, MOST_COLUMNS

Array = NDArray[np.float64]
Result = TypeVar("Result")

NAME, GAUGE = "waterline", "waterline.gauge"
"""Names of the plugins in MJCF files: the water, and the sensor (see `gauge`)."""

INSTANCE = "water"
"""Name of the instance that is added to a model without one."""

ELEMENT = f'<extension><plugin plugin="{NAME}"><instance name="{INSTANCE}"/></plugin></extension>'
"""The element that a model with a tuple `buoyant` needs in order to float."""

SENSOR, PASSIVE = 1 << 1, 1 << 2
"""MuJoCo's mjPLUGIN_SENSOR and mjPLUGIN_PASSIVE."""

POSITION_STAGE = 1
"""MuJoCo's mjSTAGE_POS, in which gauges are read."""

NOTICE_SECONDS = 2.0
"""Time of compiling after which a notice is printed."""

KERNEL_COUNT = 205
"""Number of kernels of a first run, for the notice."""


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


# Queries of a model or a state


def has_water(model: mujoco.MjModel) -> bool:
    """Whether a model has an instance of the plugin."""
    return _slot(NAME) in model.plugin


def context_of(model: mujoco.MjModel) -> Context:
    """The context of a model. Raises ModelError with all faults of the model."""
    with contexts.lock:
        return _found(model._address)[0]


def counted(data: mujoco.MjData, number: int) -> int:
    """The word with a number in a state's `native.HOME`; 0 for a state without a home."""
    home = homes.home(data._address)
    return word_at(home + 8 * number) if home else 0


def memories_of(model: mujoco.MjModel, data: mujoco.MjData) -> list[Array]:
    """Arrays of memory rows (N, 12) of all bodies that can move, in order of precedence."""
    instance = model.plugin.tolist().index(_slot(NAME))
    start = int(model.plugin_stateadr[instance])
    count = int(np.count_nonzero(model.body_weldid))
    states = data.plugin_state[start : start + native.MEMORY_SIZE * count]
    states = np.reshape(states, (count, native.MEMORY_SIZE))
    home = homes.home(data._address)
    if not home:
        return [states]
    kept = floats_at(home + native.HOME_SIZE, (len(states), native.HOME_ROW_SIZE)).copy()
    latest, *earlier = np.split(kept, 1 + native.EARLIER_ROWS, axis=1)
    return [latest, states, *earlier]


# Reading models


def _found(model: int, like: mujoco.MjModel | None = None) -> tuple[Context, int]:
    """The context of the model at an address, and the number of its content. like: a model of the
    same structure, if the model at the address cannot be copied. Raises ModelError."""

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


def _check_room(model: int, instance: int, context: Context) -> None:
    """Refuse a context whose memory is larger than the plugin's state. Raises ModelError."""
    sizes = _integers_of(model, "plugin_statenum", "nplugin")
    if context.state_size > sizes[instance]:
        fault = "the model was compiled without room for the memory of its bodies: compile it again"
        raise ModelError([fault])


def _apart(task: Callable[[], Result]) -> Result:
    """Run a task in another thread. A task that calls MuJoCo while MuJoCo waits for this one must
    not run in the waiting thread, because each call changes where errors of its thread go."""
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
    """A copy of the model at an address."""
    copy_model = mujoco_library().mj_copyModel
    copy_model.restype = ADDRESS
    return mujoco.MjModel._from_model_ptr(copy_model(None, ADDRESS(model)))  # the MjModel owns it


def _look_at(model: int, context: Context) -> None:
    """Check the properties of a model that are not in its context, and warn of likely mistakes.
    Raises ModelError."""

    def look() -> list[str]:
        own, faults = _copy_of(model), Faults()
        check_physics(own, faults)
        with faults.collected():
            start = first_state(own)
        faults.refuse()
        sea, floats = context.sea, context.floats
        return [*notes_about(own, sea, floats), *notes_about_positions(own, start, sea, floats)]

    say([*context.notes, *_apart(look)])


@contextmanager
def _notice_of_compiling() -> Iterator[None]:
    """Say that kernels are compiled, if that takes long: one line, which counts them on a
    terminal."""
    begun, is_terminal, is_said = monotonic(), sys.stderr.isatty(), False

    def tell() -> None:
        nonlocal is_said
        if monotonic() - begun < NOTICE_SECONDS or (is_said and not is_terminal):
            return
        is_said = True
        text = "waterline: compiling its kernels, which takes a minute or two, once on this machine"
        if is_terminal:
            text = f"\r{text}: {kept_kernels()} of about {KERNEL_COUNT}"
        print(text, end="" if is_terminal else "\n", file=sys.stderr, flush=True)

    with when_compiling(tell):
        try:
            yield
        finally:
            if is_said and is_terminal:
                print(file=sys.stderr)


# Functions that MuJoCo calls


@ctypes.CFUNCTYPE(INTEGER, WORD, INTEGER)
def _nstate(model: int, instance: int) -> int:
    """The length of the plugin's state: a memory row for each body that can move, the content
    number, and room for the memory of the water. MuJoCo has filled no tuple, numeric and text yet,
    but names and numbers, so the floating bodies are unknown."""
    thread.is_compiling = True
    if not _acts(model, instance):
        return 0
    return native.MEMORY_SIZE * _movable_bodies(model) + 1 + _memory_room(model)


def _memory_room(model: int) -> int:
    """The most numbers that the memory of the water may need (see `response`). All numerics
    together bound the columns given in MJCF; a file has at most MOST_COLUMNS."""

    def count(kind: str, word: str) -> int:
        starts = _integers_of(model, f"name_{kind}adr", f"n{kind}")
        return sum(word.encode() in ctypes.string_at(names + start) for start in starts)

    names = word_at(model + declared("names"))
    given, files = count("numeric", MEMORY), count("text", HYDRODYNAMICS)
    if given + files == 0:
        return 0
    columns = MOST_COLUMNS * files
    if given:
        columns += integers_at(model + declared("nnumericdata"), 1)[0] // COLUMN_SIZE
    return FIRST_STATE + 6 * (given + files) + 2 * columns


@ctypes.CFUNCTYPE(INTEGER, WORD, WORD, INTEGER)
def _init(model: int, data: int, instance: int) -> int:
    """Make the home of a new MjData, and put the home's number into the plugin's word (0 without a
    home); or refuse the model."""
    is_compiling, thread.is_compiling = thread.is_compiling, False
    word = _plugin_word(data, instance)
    word.value = 0
    if thread.is_reading or not _acts(model, instance):
        return 0
    try:
        with contexts.lock:
            context, content = _found(model)
            _join_kernels()
            _check_room(model, instance, context)
            if is_compiling:
                _look_at(model, context)
            starts = word_at(model + declared("plugin_stateadr"))
            states = word_at(data + declared("plugin_state"))
            states += 8 * integers_at(starts, instance + 1)[instance]
            word.value = homes.add(data, states, context, content, _movable_bodies(model))
    except KeyboardInterrupt as interrupt:  # cannot pass through MuJoCo: see `refusals_raised`
        refused(ModelError(["interrupted"]))
        thread.refusal = interrupt
        return -1
    except Exception as error:
        return refused(error)
    return 0


@ctypes.CFUNCTYPE(None, WORD, WORD, WORD)
def _find(model: int, data: int, instance: int) -> None:
    """Correct the word of an MjData that a pickle has overwritten."""
    with contexts.lock:
        _plugin_word(data, instance).value = homes.number(data)


@ctypes.CFUNCTYPE(None, WORD, WORD)
def _renew(model: int, states: int) -> None:
    """Give an MjData that is being reset the context of its model in its present form. states: the
    address of the plugin's states in the MjData. If the model is refused, steps give NaN until the
    model is corrected and the state is reset."""
    with contexts.lock:
        data = homes.data_of(states)
        home = homes.home(data)
        if not home:
            return
        slots = _integers_of(model, "plugin", "nplugin")
        _plugin_word(data, slots.index(_slot(NAME))).value = homes.number(data)
        try:
            before = contexts.at(word_at(home + 8 * native.CONTEXT_OF))
            context, content = _found(model, like=before.model)
            _check_room(model, slots.index(_slot(NAME)), context)
            context.adopt(home, content)
        except Exception as error:
            WORD.from_address(home + 8 * native.REFUSED).value = 1
            refused(error)


@ctypes.CFUNCTYPE(INTEGER, WORD, INTEGER)
def _no_state(model: int, instance: int) -> int:
    return 0


@ctypes.CFUNCTYPE(INTEGER, WORD, INTEGER, INTEGER)
def _gauged(model: int, instance: int, sensor: int) -> int:
    return GAUGE_SIZE


@ctypes.CFUNCTYPE(INTEGER, WORD, WORD, INTEGER)
def _init_gauge(model: int, data: int, instance: int) -> int:
    """Refuse a gauge without water, or without a site."""
    if thread.is_reading:
        return 0
    if _slot(NAME) not in _integers_of(model, "plugin", "nplugin"):
        fault = f"the plugin '{GAUGE}' reads the water of '{NAME}': add {ELEMENT}"
        return refused(ModelError([fault]))
    instances = _integers_of(model, "sensor_plugin", "nsensor")
    kinds = _integers_of(model, "sensor_objtype", "nsensor")
    site = int(mujoco.mjtObj.mjOBJ_SITE)
    if any(n == instance and kind != site for n, kind in zip(instances, kinds, strict=True)):
        return refused(ModelError([f"the plugin '{GAUGE}' needs a site: set objtype=\"site\""]))
    with _notice_of_compiling():
        _plugin(GAUGE).compute = gauge_at.address
    return 0


@ctypes.CFUNCTYPE(None, WORD, WORD, WORD, WORD, INTEGER)
def _draw(model: int, data: int, option: int, scene: int, instance: int) -> None:
    """Draw the first picture, and let the kernel, which is compiled only now, draw the others."""
    with _notice_of_compiling():
        _plugin(NAME).visualize = draw_at.address
    draw_at.call(model, data, option, scene, instance)


@ctypes.CFUNCTYPE(None)
def _nothing() -> None:
    """A placeholder for functions that MuJoCo requires before the kernels are compiled."""


def _plugin_word(data: int, instance: int) -> ctypes.c_int64:
    """The word of an instance in an MjData."""
    return WORD.from_address(word_at(data + declared("plugin_data")) + 8 * instance)


def _acts(model: int, instance: int) -> bool:
    """Whether an instance is the first of this plugin in the model. The others do nothing."""
    slots = integers_at(word_at(model + declared("plugin")), instance + 1)
    return slots.index(slots[instance]) == instance


def _movable_bodies(model: int) -> int:
    """The number of bodies that can move."""
    weldids = _integers_of(model, "body_weldid", "nbody")
    return len(weldids) - weldids.count(0)


def _integers_of(model: int, name: str, size: str) -> list[int]:
    """The integers in a field of the model at an address; the field `size` has their number."""
    return integers_at(word_at(model + declared(name)), integers_at(model + declared(size), 1)[0])


def _plugin(name: str) -> Plugin:
    """A plugin in MuJoCo's table."""
    plugin_at = mujoco_library().mjp_getPluginAtSlot
    plugin_at.restype = ctypes.POINTER(Plugin)
    return plugin_at(_slot(name)).contents


def _slot(name: str) -> int:
    """The number of a plugin in MuJoCo's table, -1 before it is registered."""
    slot = INTEGER(-1)
    mujoco_library().mjp_getPlugin(name.encode(), ctypes.byref(slot))
    return slot.value


# Registration


def register() -> None:
    """Register the plugins with MuJoCo. Importing the package compiles nothing: kernels are put
    into MuJoCo's table when the first model needs them."""
    water = Plugin(name=NAME.encode(), capabilities=PASSIVE)
    water.nstate, water.init = callback_address(_nstate), callback_address(_init)
    sensor = Plugin(name=GAUGE.encode(), capabilities=SENSOR, stage=POSITION_STAGE)
    sensor.nstate, sensor.init = callback_address(_no_state), callback_address(_init_gauge)
    sensor.nsensordata = callback_address(_gauged)
    for plugin in (water, sensor):
        plugin.reset = plugin.compute = callback_address(_nothing)
        plugin.advance = 0 if plugin is sensor else callback_address(_nothing)
        if _slot(plugin.name.decode()) < 0:
            mujoco_library().mjp_registerPlugin(ctypes.byref(plugin))
    with reading():  # compiles a model, which `init` must not do inside the compiler
        offsets()


@cache
def _join_kernels() -> None:
    """Put the kernels into MuJoCo's table of plugins."""
    for number, name in (
        (native.WORDS, "plugin_data"), (native.INSTANCES, "nplugin"), (native.SLOTS, "plugin")
    ):  # fmt: skip
        native.SEAM[number] = offsets()[name]
    native.SEAM[native.SLOT] = _slot(NAME)
    native.SEAM[native.SLABS] = homes.directory.ctypes.data
    native.SEAM[native.FIND], native.SEAM[native.RENEW] = (
        callback_address(_find),
        callback_address(_renew),
    )
    plugin = _plugin(NAME)
    plugin.reset, plugin.compute = native.reset_at.address, native.compute_at.address
    plugin.copy, plugin.destroy = native.copy_at.address, native.destroy_at.address
    plugin.advance, plugin.visualize = native.advance_at.address, callback_address(_draw)


@atexit.register
def _keep_kernels() -> None:
    """Keep the functions and tables that states use, because states may outlive the interpreter."""
    functions = [value for value in vars(native).values() if isinstance(value, CFunction)]
    for value in (*functions, respond_at, draw_at, gauge_at, native.SEAM, homes, *contexts):
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(value))


register()
