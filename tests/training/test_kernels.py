"""What holds for every kernel that a training run calls."""

import gc

from numba.core import types
from numba.core.dispatcher import Dispatcher

from stylesplat.scene.capture import Capture
from stylesplat.training.loop import fit
from stylesplat.training.train_config import TrainConfig


def numbers(kind: types.Type) -> bool:
    parts = kind if isinstance(kind, types.Tuple | types.UniTuple) else [kind]
    return all(isinstance(part, types.Number | types.NoneType) for part in parts)


def test_none_can_crash_where_it_is_interrupted(capture: Capture, config: TrainConfig):
    """numba unpickles the type of an array that is returned, and does not see that fail."""
    fit(capture, config)
    found = [
        (name, compiled.signature.return_type)
        for it in gc.get_objects()
        if issubclass(type(it), Dispatcher)
        and (name := it.py_func.__module__).startswith("stylesplat.")
        if not it.targetoptions.get("no_cpython_wrapper")
        for compiled in it.overloads.values()
    ]
    assert len({name for name, _ in found}) > 4
    assert [(name, kind) for name, kind in found if not numbers(kind)] == []
