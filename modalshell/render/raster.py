"""Drawing triangles into a depth buffer, and the normals and shades of their corners, compiled."""

import math

import numpy as np

from modalshell.kernels.compiler import UNCOUNTED, njit

_kernel = njit(error_model="numpy", fastmath=False, nogil=True, **UNCOUNTED)


@_kernel
def unit_normals(vertices, faces, flat, smooth):  # type: ignore[no-untyped-def]
    """Unit normals of ``faces`` (T, 3) into ``flat`` (T, 3), and averaged by area at vertices into ``smooth`` (n, 3).

    Zero for a face without area. ``smooth`` is zero before.
    """
    for t in range(faces.shape[0]):
        i, j, k = faces[t, 0], faces[t, 1], faces[t, 2]
        ax, ay, az = vertices[j, 0] - vertices[i, 0], vertices[j, 1] - vertices[i, 1], vertices[j, 2] - vertices[i, 2]
        bx, by, bz = vertices[k, 0] - vertices[i, 0], vertices[k, 1] - vertices[i, 1], vertices[k, 2] - vertices[i, 2]
        flat[t, 0], flat[t, 1], flat[t, 2] = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        for vertex in (i, j, k):
            for c in range(3):
                smooth[vertex, c] += flat[t, c]
    for normals in (flat, smooth):
        for t in range(normals.shape[0]):
            length = math.sqrt(normals[t, 0] ** 2 + normals[t, 1] ** 2 + normals[t, 2] ** 2)
            for c in range(3):
                normals[t, c] = normals[t, c] / length if length > 0.0 else 0.0


@_kernel
def seen_faces(vertices, faces, flat, position, seen):  # type: ignore[no-untyped-def]
    """Write into ``seen`` (T,) whether faces of normals ``flat`` (T, 3) look towards ``position`` (3,): 1, 0, -1."""
    for t in range(faces.shape[0]):
        toward = 0.0
        for c in range(3):
            middle = (vertices[faces[t, 0], c] + vertices[faces[t, 1], c] + vertices[faces[t, 2], c]) / 3.0
            toward += flat[t, c] * (position[c] - middle)
        seen[t] = (toward > 0.0) - (toward < 0.0)


@_kernel
def outline(left, right, drawn, flat, seen, shown):  # type: ignore[no-untyped-def]
    """Write into ``shown`` (E,) whether edges are ``drawn`` anyway or between a face seen and one turned away.

    Where neighbours are wound apart their normals disagree without any contour.
    """
    for e in range(left.shape[0]):
        f, s = left[e], right[e]
        aligned = flat[f, 0] * flat[s, 0] + flat[f, 1] * flat[s, 1] + flat[f, 2] * flat[s, 2] > -0.5
        shown[e] = drawn[e] or ((seen[f] > 0) != (seen[s] > 0) and aligned)


@_kernel
def _clipped(value, most):  # type: ignore[no-untyped-def]
    """``value`` (float) between 0 and ``most`` (float); numba's min and max are compiled for each caller."""
    low = value if value > 0.0 else 0.0
    return low if low < most else most


@_kernel
def shade(faces, normals, by_vertex, seen, colors, lights, ambient, out):  # type: ignore[no-untyped-def]
    """Shaded colours at the corners of the faces into ``out`` (T, 3, 3), the same from both sides.

    ``normals`` are those of the vertices or of the faces. ``lights`` (k, 4) are unit vectors to lights, and powers.
    """
    for t in range(faces.shape[0]):
        side = -1.0 if seen[t] < 0 else 1.0
        for corner in range(3):
            vertex = faces[t, corner]
            at = vertex if by_vertex else t
            light = ambient
            for k in range(lights.shape[0]):
                cosine = 0.0
                for c in range(3):
                    cosine += side * normals[at, c] * lights[k, c]
                light += lights[k, 3] * (cosine if cosine > 0.0 else 0.0)
            for c in range(3):
                out[t, corner, c] = _clipped(colors[vertex, c] * light, 1.0)


@_kernel
def draw_triangles(corners, heights, shades, opacity, near, color, alpha, box):  # type: ignore[no-untyped-def]
    """Draw triangles, keeping at each pixel what is nearest; exact coverage, so no seams and no order of painting.

    ``corners`` (T, 3, 2) are columns and rows, ``heights`` (T, 3) nearness to the camera, ``shades`` (T, 3, 3) colours.
    ``near`` (h, w), ``color`` (h, w, 3) and ``alpha`` (h, w) are written to; ``box`` (4,), first and last row and
    column drawn to, grows.
    """
    rows, columns = float(near.shape[0]), float(near.shape[1])
    for t in range(corners.shape[0]):
        x0, y0, x1, y1 = corners[t, 0, 0], corners[t, 0, 1], corners[t, 1, 0], corners[t, 1, 1]
        x2, y2 = corners[t, 2, 0], corners[t, 2, 1]
        low, high = (y0, y1) if y0 < y1 else (y1, y0)
        low, high = y2 if y2 < low else low, y2 if y2 > high else high
        if not (low < rows and high > 0.0 and abs(x0) + abs(x1) + abs(x2) < 1e12 and abs(low) + abs(high) < 1e12):
            continue
        top, foot = math.ceil(_clipped(low - 0.5, rows)), math.ceil(_clipped(high - 0.5, rows))
        ax, ay, bx, by = x1 - x0, y1 - y0, x2 - x0, y2 - y0
        area = ax * by - ay * bx
        inverse = 1.0 / area if abs(area) > 1e-12 else 0.0
        ax, ay, bx, by = ax * inverse, ay * inverse, bx * inverse, by * inverse
        rise, climb = heights[t, 1] - heights[t, 0], heights[t, 2] - heights[t, 0]
        nearer, nearer_down = rise * by - climb * ay, climb * ax - rise * bx
        rise, climb = shades[t, 1, 0] - shades[t, 0, 0], shades[t, 2, 0] - shades[t, 0, 0]
        redder, redder_down = rise * by - climb * ay, climb * ax - rise * bx
        rise, climb = shades[t, 1, 1] - shades[t, 0, 1], shades[t, 2, 1] - shades[t, 0, 1]
        greener, greener_down = rise * by - climb * ay, climb * ax - rise * bx
        rise, climb = shades[t, 1, 2] - shades[t, 0, 2], shades[t, 2, 2] - shades[t, 0, 2]
        bluer, bluer_down = rise * by - climb * ay, climb * ax - rise * bx
        for row in range(top, foot):
            middle = row + 0.5
            left, right = np.inf, -np.inf
            for side in range(3):
                after = (side + 1) % 3
                px, py, qx, qy = corners[t, side, 0], corners[t, side, 1], corners[t, after, 0], corners[t, after, 1]
                # Neighbours walk a common side in opposite directions: order its ends so that both find one column.
                if py > qy:
                    px, py, qx, qy = qx, qy, px, py
                if py <= middle < qy:
                    column = px + (middle - py) / (qy - py) * (qx - px)
                    left, right = column if column < left else left, column if column > right else right
            if not left <= right:
                continue
            begin = math.ceil(_clipped(left - 0.5, columns))
            end = math.ceil(_clipped(right - 0.5, columns))
            if end <= begin:
                continue
            box[0], box[1] = row if row < box[0] else box[0], row if row > box[1] else box[1]
            box[2], box[3] = begin if begin < box[2] else box[2], end - 1 if end > box[3] else box[3]
            down = row + 0.5 - y0
            first, red = heights[t, 0] + down * nearer_down, shades[t, 0, 0] + down * redder_down
            green, blue = shades[t, 0, 1] + down * greener_down, shades[t, 0, 2] + down * bluer_down
            for column in range(begin, end):
                across = column + 0.5 - x0
                height = first + across * nearer
                if height >= near[row, column]:
                    near[row, column], alpha[row, column] = height, opacity
                    color[row, column, 0] = _clipped(red + across * redder, 1.0)
                    color[row, column, 1] = _clipped(green + across * greener, 1.0)
                    color[row, column, 2] = _clipped(blue + across * bluer, 1.0)


@njit(error_model="numpy", fastmath=False)
def flatten(near, color, alpha, box, factor, out):  # type: ignore[no-untyped-def]
    """Lay layers over white from far to near and average blocks of pixels into ``out`` (h, w, 3), white before.

    ``near`` (L, h, w), ``color`` (L, h, w, 3) and ``alpha`` (L, h, w) as of :func:`draw_triangles`; outside ``box``
    (4,) the picture is white. The layers are empty afterwards.
    """
    layers = near.shape[0]
    order = np.empty(layers, np.int64)
    total, page, one = np.empty(3, np.int64), np.empty(3, np.float32), np.float32(1.0)
    for row in range(box[0] // factor, box[1] // factor + 1):
        for column in range(box[2] // factor, box[3] // factor + 1):
            total[:] = 0
            for i in range(row * factor, (row + 1) * factor):
                for j in range(column * factor, (column + 1) * factor):
                    page[:] = 1.0
                    for layer in range(layers):
                        place = layer
                        while place > 0 and near[order[place - 1], i, j] > near[layer, i, j]:
                            order[place] = order[place - 1]
                            place -= 1
                        order[place] = layer
                    for layer in order:
                        if near[layer, i, j] > -np.inf:
                            opacity = alpha[layer, i, j]
                            for c in range(3):
                                page[c] = (one - opacity) * page[c] + opacity * color[layer, i, j, c]
                            near[layer, i, j] = -np.inf
                    for c in range(3):
                        total[c] += int(np.rint(np.float32(255.0) * page[c]))
            for c in range(3):
                out[row, column, c] = (total[c] + factor * factor // 2) // (factor * factor)


@_kernel
def flatten_one(near, color, alpha, box, factor, behind, pixels, out):  # type: ignore[no-untyped-def]
    """:func:`flatten` of one layer: ``near`` (h, w), ``color`` (h, w, 3) and ``alpha`` (h, w) of opaque surfaces.

    ``behind`` (h, w) and ``pixels`` (h, w, 3) are the nearness and the colours of what stands still, which ``out``
    shows before; it hides what is not nearer.
    """
    one, full, block = np.float32(1.0), np.float32(255.0), factor * factor
    for row in range(box[0] // factor, box[1] // factor + 1):
        for column in range(box[2] // factor, box[3] // factor + 1):
            red = green = blue = block // 2
            seen = False
            for i in range(row * factor, (row + 1) * factor):
                for j in range(column * factor, (column + 1) * factor):
                    if near[i, j] > behind[i, j]:
                        seen = True
                        opacity = alpha[i, j]
                        rest = one - opacity
                        red += int(np.rint(full * (rest + opacity * color[i, j, 0])))
                        green += int(np.rint(full * (rest + opacity * color[i, j, 1])))
                        blue += int(np.rint(full * (rest + opacity * color[i, j, 2])))
                    else:
                        red += pixels[i, j, 0]
                        green += pixels[i, j, 1]
                        blue += pixels[i, j, 2]
                    near[i, j] = -np.inf
            if seen:
                out[row, column, 0] = red // block
                out[row, column, 1] = green // block
                out[row, column, 2] = blue // block


@_kernel
def shrink(pixels, factor, out):  # type: ignore[no-untyped-def]
    """Average blocks of ``factor`` x ``factor`` pixels (H, W, 3) into ``out`` (h, w, 3)."""
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            for c in range(3):
                total = factor * factor // 2
                for i in range(row * factor, (row + 1) * factor):
                    for j in range(column * factor, (column + 1) * factor):
                        total += pixels[i, j, c]
                out[row, column, c] = total // (factor * factor)
