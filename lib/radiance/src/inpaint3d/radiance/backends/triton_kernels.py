"""Triton kernels for GPUs: hash grids, small networks, Adam. `triton` wraps them with the signatures of `reference`.

Accumulation into tables and weights is by atomic additions, whose order is not the same each time: gradients repeat to
rounding, not to the bit.
"""
# pyright: reportMissingImports=false, reportUnreachable=false

import triton
import triton.language as tl

# Instant-NGP's spatial hash (arXiv:2201.05989, eq. 4); products wrap at 32 bits, whose low bits are all that counts.
PRIME_Y = tl.constexpr(2654435761)
PRIME_Z = tl.constexpr(805459861)


@triton.jit
def _find_cell(points, i, inside, axis: tl.constexpr, resolution):
    """The cell's lower vertex along an axis, and how far the point lies in it."""
    scaled = tl.load(points + 3 * i + axis, mask=inside, other=0.0) * resolution.to(tl.float32)
    low = tl.minimum(tl.maximum(tl.floor(scaled), 0.0), (resolution - 1).to(tl.float32))
    return low.to(tl.int32), low + 1.0 - scaled, scaled - low


@triton.jit
def _find_entry(x, y, z, resolution, size, dense):
    side = resolution + 1
    straight = x + side * (y + side * z)
    mixed = x.to(tl.uint32) ^ (y.to(tl.uint32) * PRIME_Y) ^ (z.to(tl.uint32) * PRIME_Z)
    hashed = (mixed & (size - 1).to(tl.uint32)).to(tl.int32)
    return tl.where(dense > 0, straight, hashed)


@triton.jit
def hash_forward(points, table, layout, out, n, LEVELS: tl.constexpr, CHANNELS: tl.constexpr, BLOCK: tl.constexpr):
    """Features [n, LEVELS * CHANNELS] of points [n, 3]. layout: resolution, offset, size, dense of each level."""
    i = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    level = tl.program_id(1)
    inside = i < n
    resolution, offset = tl.load(layout + 4 * level), tl.load(layout + 4 * level + 1)
    size, dense = tl.load(layout + 4 * level + 2), tl.load(layout + 4 * level + 3)
    x, x_far, x_near = _find_cell(points, i, inside, 0, resolution)
    y, y_far, y_near = _find_cell(points, i, inside, 1, resolution)
    z, z_far, z_near = _find_cell(points, i, inside, 2, resolution)
    channel = tl.arange(0, CHANNELS)
    total = tl.zeros([BLOCK, CHANNELS], tl.float32)
    for corner in tl.static_range(8):
        up_x, up_y, up_z = corner % 2, corner // 2 % 2, corner // 4
        entry = _find_entry(x + up_x, y + up_y, z + up_z, resolution, size, dense)
        weight = (z_near if up_z else z_far) * (y_near if up_y else y_far) * (x_near if up_x else x_far)
        at = (offset + entry).to(tl.int64)[:, None] * CHANNELS + channel[None, :]
        total += weight[:, None] * tl.load(table + at, mask=inside[:, None], other=0.0)
    to = i[:, None] * (LEVELS * CHANNELS) + level * CHANNELS + channel[None, :]
    tl.store(out + to, total, mask=inside[:, None])


@triton.jit
def hash_backward(
    points, out_grad, layout, table_grad, n, LEVELS: tl.constexpr, CHANNELS: tl.constexpr, BLOCK: tl.constexpr
):
    """Adds the gradient of the table, which starts at 0."""
    i = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    level = tl.program_id(1)
    inside = i < n
    resolution, offset = tl.load(layout + 4 * level), tl.load(layout + 4 * level + 1)
    size, dense = tl.load(layout + 4 * level + 2), tl.load(layout + 4 * level + 3)
    x, x_far, x_near = _find_cell(points, i, inside, 0, resolution)
    y, y_far, y_near = _find_cell(points, i, inside, 1, resolution)
    z, z_far, z_near = _find_cell(points, i, inside, 2, resolution)
    channel = tl.arange(0, CHANNELS)
    of = i[:, None] * (LEVELS * CHANNELS) + level * CHANNELS + channel[None, :]
    grad = tl.load(out_grad + of, mask=inside[:, None], other=0.0)
    for corner in tl.static_range(8):
        up_x, up_y, up_z = corner % 2, corner // 2 % 2, corner // 4
        entry = _find_entry(x + up_x, y + up_y, z + up_z, resolution, size, dense)
        weight = (z_near if up_z else z_far) * (y_near if up_y else y_far) * (x_near if up_x else x_far)
        at = (offset + entry).to(tl.int64)[:, None] * CHANNELS + channel[None, :]
        tl.atomic_add(table_grad + at, weight[:, None] * grad, mask=inside[:, None], sem="relaxed")


@triton.jit
def _load_matrix(at, rows: tl.constexpr, columns: tl.constexpr, ROWS: tl.constexpr, COLUMNS: tl.constexpr):
    """A weight [rows, columns], padded with zeros."""
    row, column = tl.arange(0, ROWS), tl.arange(0, COLUMNS)
    there = (row < rows)[:, None] & (column < columns)[None, :]
    return tl.load(at + row[:, None] * columns + column[None, :], mask=there, other=0.0)


@triton.jit
def _load_rows(at, i, inside, width: tl.constexpr, WIDTH: tl.constexpr):
    column = tl.arange(0, WIDTH)
    there = inside[:, None] & (column < width)[None, :]
    return tl.load(at + i[:, None] * width + column[None, :], mask=there, other=0.0)


@triton.jit
def _put_rows(at, values, i, inside, width: tl.constexpr, WIDTH: tl.constexpr):
    column = tl.arange(0, WIDTH)
    there = inside[:, None] & (column < width)[None, :]
    tl.store(at + i[:, None] * width + column[None, :], values, mask=there)


@triton.jit
def _add_matrix(at, values, rows: tl.constexpr, columns: tl.constexpr, ROWS: tl.constexpr, COLUMNS: tl.constexpr):
    row, column = tl.arange(0, ROWS), tl.arange(0, COLUMNS)
    there = (row < rows)[:, None] & (column < columns)[None, :]
    tl.atomic_add(at + row[:, None] * columns + column[None, :], values, mask=there, sem="relaxed")


@triton.jit
def mlp_forward(
    x, first, middle, last, starts, out, n, run,
    N_IN: tl.constexpr, N_HIDDEN: tl.constexpr, N_OUT: tl.constexpr,
    P_IN: tl.constexpr, P_HIDDEN: tl.constexpr, P_OUT: tl.constexpr,
    DEEP: tl.constexpr, STARTS: tl.constexpr, PRECISION: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """A network of two layers, or three where DEEP, on rows [n, N_IN].

    P_IN, P_HIDDEN, P_OUT: the widths N_... as the units want them, padded with zeros.

    STARTS: the first sums start from a row [N_HIDDEN] of `starts` for each run of rows.
    """
    i = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    inside = i < n
    hidden = tl.dot(
        _load_rows(x, i, inside, N_IN, P_IN),
        tl.trans(_load_matrix(first, N_HIDDEN, N_IN, P_HIDDEN, P_IN)),
        input_precision=PRECISION,
    )
    if STARTS:
        hidden += _load_rows(starts, i // run, inside, N_HIDDEN, P_HIDDEN)
    hidden = tl.maximum(hidden, 0.0)
    if DEEP:
        hidden = tl.maximum(
            tl.dot(
                hidden,
                tl.trans(_load_matrix(middle, N_HIDDEN, N_HIDDEN, P_HIDDEN, P_HIDDEN)),
                input_precision=PRECISION,
            ),
            0.0,
        )
    made = tl.dot(hidden, tl.trans(_load_matrix(last, N_OUT, N_HIDDEN, P_OUT, P_HIDDEN)), input_precision=PRECISION)
    _put_rows(out, made, i, inside, N_OUT, P_OUT)


@triton.jit
def mlp_backward(
    x, first, middle, last, starts, out_grad, x_grad, first_grad, middle_grad, last_grad, starts_grad, n, run,
    N_IN: tl.constexpr, N_HIDDEN: tl.constexpr, N_OUT: tl.constexpr,
    P_IN: tl.constexpr, P_HIDDEN: tl.constexpr, P_OUT: tl.constexpr,
    DEEP: tl.constexpr, STARTS: tl.constexpr, PRECISION: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Gradients; those of weights and starts are added up and start at 0. Hidden rows are computed again."""
    w_first = _load_matrix(first, N_HIDDEN, N_IN, P_HIDDEN, P_IN)
    w_last = _load_matrix(last, N_OUT, N_HIDDEN, P_OUT, P_HIDDEN)
    d_first, d_last = (
        tl.zeros([P_HIDDEN, P_IN], tl.float32),
        tl.zeros([P_OUT, P_HIDDEN], tl.float32),
    )
    d_middle = tl.zeros([P_HIDDEN, P_HIDDEN], tl.float32)
    tile = tl.program_id(0)
    while tile * BLOCK < n:
        i = tile.to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
        inside = i < n
        rows = _load_rows(x, i, inside, N_IN, P_IN)
        hidden = tl.dot(rows, tl.trans(w_first), input_precision=PRECISION)
        if STARTS:
            hidden += _load_rows(starts, i // run, inside, N_HIDDEN, P_HIDDEN)
        hidden = tl.maximum(hidden, 0.0)
        grad = _load_rows(out_grad, i, inside, N_OUT, P_OUT)
        if DEEP:
            w_middle = _load_matrix(middle, N_HIDDEN, N_HIDDEN, P_HIDDEN, P_HIDDEN)
            deep = tl.maximum(tl.dot(hidden, tl.trans(w_middle), input_precision=PRECISION), 0.0)
            d_last += tl.dot(tl.trans(grad), deep, input_precision=PRECISION)
            down = tl.where(deep > 0, tl.dot(grad, w_last, input_precision=PRECISION), 0.0)
            d_middle += tl.dot(tl.trans(down), hidden, input_precision=PRECISION)
            down = tl.where(hidden > 0, tl.dot(down, w_middle, input_precision=PRECISION), 0.0)
        else:
            d_last += tl.dot(tl.trans(grad), hidden, input_precision=PRECISION)
            down = tl.where(hidden > 0, tl.dot(grad, w_last, input_precision=PRECISION), 0.0)
        d_first += tl.dot(tl.trans(down), rows, input_precision=PRECISION)
        _put_rows(x_grad, tl.dot(down, w_first, input_precision=PRECISION), i, inside, N_IN, P_IN)
        if STARTS:
            column = tl.arange(0, P_HIDDEN)
            there = inside[:, None] & (column < N_HIDDEN)[None, :]
            tl.atomic_add(
                starts_grad + (i // run)[:, None] * N_HIDDEN + column[None, :], down, mask=there, sem="relaxed"
            )
        tile += tl.num_programs(0)
    _add_matrix(first_grad, d_first, N_HIDDEN, N_IN, P_HIDDEN, P_IN)
    _add_matrix(last_grad, d_last, N_OUT, N_HIDDEN, P_OUT, P_HIDDEN)
    if DEEP:
        _add_matrix(middle_grad, d_middle, N_HIDDEN, N_HIDDEN, P_HIDDEN, P_HIDDEN)


@triton.jit
def adam(
    param, grad, m, v, lost, n, step_size, beta1, beta2, unbias, eps, decay, SPARSE: tl.constexpr, BLOCK: tl.constexpr
):
    """`reference.adam_step` in one pass; unbias: 1 / (1 - beta2^step); lost: where numbers left alone are counted."""
    i = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    inside = i < n
    slope = tl.load(grad + i, mask=inside, other=0.0)
    wanted = inside & (slope != 0.0) if SPARSE else inside
    here = tl.load(param + i, mask=inside, other=0.0)
    slope = slope + decay * here
    first = tl.load(m + i, mask=inside, other=0.0)
    first = first + (1.0 - beta1) * (slope - first)
    second = beta2 * tl.load(v + i, mask=inside, other=0.0) + (1.0 - beta2) * slope * slope
    to = here - step_size * first / (tl.sqrt(second * unbias) + eps)
    finite = (tl.abs(second) < float("inf")) & (tl.abs(to) < float("inf"))
    moves = wanted & finite
    tl.store(param + i, to, mask=moves)
    tl.store(m + i, first, mask=moves)
    tl.store(v + i, second, mask=moves)
    astray = tl.sum((wanted & (finite == 0)).to(tl.int32))
    if astray > 0:
        tl.atomic_add(lost, astray)
