"""What bounds look-ups of means: to find rows, and to sum them, each with nothing of the other.

An instrumented copy of the look-ups' code lists each node's first row, its number of rays and where their weights
stand; a kernel then sums the very same rows in the same order, with nothing to be found: what loads and memory take at
least. Another copy finds the rows and reads none of them: arithmetic alone. Together they take what look-ups take.
"""

import functools
from typing import TYPE_CHECKING, Any

import warp as wp

from warpdiff.kernels import lookup
from warpdiff.kernels.native import CHUNKS_OF_ROWS, filled
from warpdiff.kernels.scene import Footprint

if TYPE_CHECKING:
    from warpdiff.launches import Step

# Where a node's row and weights are known, in the code of look-ups.
_KNOWN = "const float* row = all_rows + (long long)row_at * WIDTH;"
_LIST = """
                    const int listed = ((int*)count_out.data)[0]++;
                    if (listed < entries_out.shape[0]) {
                        int* const entry = (int*)entries_out.data + 4LL * listed;
                        entry[0] = begin + pixels[of];
                        entry[1] = row_at;
                        entry[2] = taken;
                        entry[3] = tap_at;
                    }
"""
# Where its rows are summed up, and where those to come are asked for.
_ADDED = "tilted[l] += tilt * of_rays[l];"
_ASKED = (
    "for (int s = 0; s < segments && s < AHEAD; ++s) ask(s);",
    "if (s + AHEAD < segments) ask(s + AHEAD);",
)
# Entries ahead whose outermost rows are asked for: of 1 to 24 none took less time.
_AHEAD = 12

_SUMS = """
    const float* const all_rows = (const float*)table.rows.data;
    const float* const taps = (const float*)blending.weights.data;
    const int* const all = (const int*)entries.data;
    const long long stride = (long long)table.nodes * WIDTH;
    auto ask = [&](const int* entry) {
        const float* const row = all_rows + (long long)entry[1] * WIDTH;
        const long long across = (entry[2] - 1) * stride;
        __builtin_prefetch(row);
        __builtin_prefetch(row + WIDTH - 1);
        __builtin_prefetch(row + across);
        __builtin_prefetch(row + across + WIDTH - 1);
    };
    chunk sum[CHUNKS], total[CHUNKS];
    for (int l = 0; l < CHUNKS; ++l) sum[l] = total[l] = chunk{};
    for (int k = 0; k < count; ++k) {
        const int* const entry = all + 4LL * k;
        if (k + AHEAD < count) ask(entry + 4 * AHEAD);
        const float* row = all_rows + (long long)entry[1] * WIDTH;
        chunk of_rays[CHUNKS];
        for (int l = 0; l < CHUNKS; ++l) of_rays[l] = chunk{};
#pragma clang loop unroll_count(4)
        for (int j = 0; j < entry[2]; ++j) {
#pragma unroll
            for (int l = 0; l < CHUNKS; ++l) of_rays[l] += taps[entry[3] + j] * ((const chunk*)row)[l];
            row += stride;
        }
        for (int l = 0; l < CHUNKS; ++l) sum[l] += 0.3f * of_rays[l];
        // Pixels begin anew.
        if (k + 1 < count && entry[4] != entry[0])
            for (int l = 0; l < CHUNKS; ++l) {
                total[l] += sum[l];
                sum[l] = chunk{};
            }
    }
    for (int l = 0; l < CHUNKS; ++l) ((chunk*)out.data)[l] = total[l] + sum[l];
"""


def _that_lists_rows() -> str:
    """The look-ups' code, which lists them, too."""
    return _once(_KNOWN, _LIST + _KNOWN, lookup.MEANS)


def _that_reads_no_rows() -> str:
    """The look-ups' code without them."""
    done = lookup.MEANS[lookup.MEANS.index(_KNOWN) : lookup.MEANS.index(_ADDED) + len(_ADDED)]
    code = _once(done, "sum[0] += weight * (float)(row_at + tap_at);", lookup.MEANS)
    for asked in _ASKED:
        code = _once(asked, "", code)
    return code


def _once(part: str, other: str, code: str) -> str:
    """Code with another part in place of one that is there once."""
    if code.count(part) != 1:
        raise RuntimeError("the look-ups' code has changed: say anew where a node's row is known, summed and asked for")
    return code.replace(part, other)


@functools.cache
def _of_means(code: str, functions: int) -> Any:
    """The kernel of such code for a table with so many functions of w."""
    colours, blending = lookup.lookup(functions).Colours, lookup.Blending

    @wp.func_native(lookup.native_code(code, functions=functions))
    def meet_rows(
        table: colours,
        deflections: wp.array(dtype=wp.vec3d),
        to_lights: wp.array(dtype=wp.vec3f),
        gains: wp.array(dtype=wp.float32),
        footprints: wp.array(dtype=Footprint),
        blending: blending,
        begin: wp.int32,
        end: wp.int32,
        left_out: wp.array(dtype=wp.float32),
        xyz_out: wp.array(dtype=wp.vec3f),
        entries_out: wp.array(dtype=wp.vec4i),
        count_out: wp.array(dtype=wp.int32),
    ): ...

    @wp.kernel(module="unique", module_options=lookup.OPTIONS)
    def met(
        table: colours,
        deflections: wp.array(dtype=wp.vec3d),
        to_lights: wp.array(dtype=wp.vec3f),
        gains: wp.array(dtype=wp.float32),
        footprints: wp.array(dtype=Footprint),
        blending: blending,
        run: wp.int32,
        left_out: wp.array(dtype=wp.float32),
        xyz_out: wp.array(dtype=wp.vec3f),
        entries_out: wp.array(dtype=wp.vec4i),
        count_out: wp.array(dtype=wp.int32),
    ):
        begin = wp.tid() * run
        end = wp.min(begin + run, gains.shape[0])
        meet_rows(
            table, deflections, to_lights, gains, footprints, blending, begin, end, left_out, xyz_out, entries_out,
            count_out,
        )  # fmt: skip

    return met


@functools.cache
def _of_rows(functions: int) -> Any:
    """The kernel that sums rows of such a table."""
    colours, blending, width = lookup.lookup(functions).Colours, lookup.Blending, 3 * functions

    @wp.func_native(filled(CHUNKS_OF_ROWS + _SUMS, WIDTH=width, AHEAD=_AHEAD))
    def sum_rows(
        table: colours,
        blending: blending,
        entries: wp.array(dtype=wp.vec4i),
        count: wp.int32,
        out: wp.array(dtype=wp.float32),
    ): ...

    @wp.kernel(module="unique", module_options=lookup.OPTIONS)
    def summed(
        table: colours,
        blending: blending,
        entries: wp.array(dtype=wp.vec4i),
        count: wp.int32,
        out: wp.array(dtype=wp.float32),
    ):
        sum_rows(table, blending, entries, count, out)

    return summed


class MeanBounds:
    """The rows that means take.

    Attributes:
        entries: For each node the pixel, the first row, the number of rays, and where their weights begin, (n, 4).
        numbers: In a row.
        xyz: What ``find`` adds to, instead of colours, (pixels,).
    """

    # Nodes for which there is room, a pixel.
    _MOST = 96

    def __init__(self, look_up: "Step") -> None:
        """List those of a look-up of means on the CPU, in a table of no source."""
        table, _, _, _, footprints, blending, run = look_up.inputs
        pixels, functions = len(footprints), int(table.functions.dtype._length_)
        self._found, self._summed = _of_means(_that_reads_no_rows(), functions), _of_rows(functions)
        self._table, self._blending, self._runs = table, blending, -(-pixels // run)
        entries = wp.empty(self._MOST * pixels, dtype=wp.vec4i, device="cpu")
        count = wp.zeros(1, dtype=wp.int32, device="cpu")
        unused = wp.empty(0, dtype=wp.float32, device="cpu")
        self.xyz = wp.zeros(pixels, dtype=wp.vec3f, device="cpu")
        inputs = [*look_up.inputs, unused, self.xyz]
        wp.launch(_of_means(_that_lists_rows(), functions), self._runs, inputs, [entries, count], device="cpu")
        self._inputs = [*inputs, entries[:0], count]
        self.xyz.zero_()
        listed = int(count.numpy()[0])
        if listed > len(entries):
            raise RuntimeError(f"there is room for {self._MOST} nodes a pixel, and {listed / pixels:.0f} were listed")
        self.entries = entries.numpy()[:listed].copy()
        self._on_device = wp.array(self.entries, dtype=wp.vec4i, device="cpu")
        self.numbers = int(table.rows.dtype._length_)
        self._out = wp.zeros(self.numbers, dtype=wp.float32, device="cpu")

    def find(self) -> None:
        """Find them, on one thread."""
        wp.launch(self._found, self._runs, self._inputs, device="cpu")

    def add(self) -> None:
        """Sum them, on one thread."""
        inputs = [self._table, self._blending, self._on_device, len(self.entries)]
        wp.launch(self._summed, 1, inputs, [self._out], device="cpu")
