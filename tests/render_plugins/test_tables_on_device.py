"""Tables on the device: they are read alike wherever numpy put them in memory."""

from __future__ import annotations

import numpy as np
import pytest

from nacre.device.variant import use_variant

pytestmark = pytest.mark.render

PLACES = 5  # of four bytes each: among them every alignment that numpy's memory of single numbers may have but its own
COUNT = 2048


def test_one_kernel_reads_a_table_wherever_numpy_put_it_and_a_copy_of_it() -> None:
    use_variant()
    import drjit as dr
    import mitsuba as mi

    from nacre.device.plugin import device_array, read2
    from nacre.device.tables import DeviceTable

    if not dr.is_jit_v(mi.Float):
        pytest.skip("no LLVM: nothing is compiled")
    room = np.arange(COUNT + PLACES, dtype=np.float32)
    kernels = set()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for place in range(PLACES):
            values = room[place : place + COUNT]
            whole = DeviceTable(values.reshape(2, COUNT // 4, 2), as_cells=False)
            for source in (device_array(values), whole.packed):
                dr.kernel_history_clear()
                pair = read2(source, dr.opaque(mi.UInt32, 3) + dr.arange(mi.UInt32, 8))
                dr.eval(pair)
                kernels.add(dr.kernel_history()[-1]["hash"])
                np.testing.assert_array_equal(np.array(pair)[:, 0], [6.0 + place, 7.0 + place])
    assert len(kernels) == 1
    source = device_array(room)
    room[:] = 0.0
    assert np.asarray(source)[-1] == COUNT + PLACES - 1
