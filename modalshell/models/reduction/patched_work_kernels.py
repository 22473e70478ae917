"""Work on a fitted surface by patches of its triangles, each turned and strained as one."""

import numpy as np

from modalshell.kernels.compiler import njit
from modalshell.kernels.rotations import coefficients


@njit(error_model="numpy", fastmath=False)
def bent_push(gradients, turns, strains, q, push):  # type: ignore[no-untyped-def]
    r"""Add the gradient (m,) of ``sum_p <G_p, e^[w_p] (I + S_p) - I - [w_p] - S_p>`` to ``push``.

    ``gradients`` (P, 3, 3) are :math:`G^T`, ``turns`` (P, 3, m) the modes' rotation vectors and ``strains`` (P, 6, m)
    their strains xx, yy, zz, yz, xz, xy. With :math:`N = G (I + S)` it is as in
    :mod:`modalshell.models.reduction.rotation_strain_kernels`.
    """
    count, _, size = turns.shape
    w, g, n, r, by_w, by_s = np.empty(3), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(6)
    s, t = np.empty((3, 3)), np.empty(6)
    for p in range(count):
        for axis in range(3):
            w[axis] = 0.0
            for j in range(size):
                w[axis] += turns[p, axis, j] * q[j]
        for part in range(6):
            t[part] = 0.0
            for j in range(size):
                t[part] += strains[p, part, j] * q[j]
        s[0, 0], s[1, 1], s[2, 2] = t[0], t[1], t[2]
        s[1, 2] = s[2, 1] = t[3]
        s[0, 2] = s[2, 0] = t[4]
        s[0, 1] = s[1, 0] = t[5]
        x, y, z = w[0], w[1], w[2]
        squared = x * x + y * y + z * z
        c1, c2, c3 = coefficients(x, y, z)
        # Cancellation in c2' for small w costs nothing: w^T N w shrinks as fast.
        d1, d2 = 0.5 * (c3 - c2), 0.5 * (c1 - 2.0 * c2) / max(squared, 1e-30)
        for row in range(3):
            for column in range(3):
                g[row, column] = gradients[p, column, row]
                r[row, column] = c2 * w[row] * w[column]
            r[row, row] += 1.0 - c2 * squared
        r[2, 1] += c1 * x
        r[1, 2] -= c1 * x
        r[0, 2] += c1 * y
        r[2, 0] -= c1 * y
        r[1, 0] += c1 * z
        r[0, 1] -= c1 * z
        for row in range(3):
            for column in range(3):
                n[row, column] = g[row, column]
                for k in range(3):
                    n[row, column] += g[row, k] * s[k, column]
        lx, ly, lz = n[2, 1] - n[1, 2], n[0, 2] - n[2, 0], n[1, 0] - n[0, 1]
        quadratic = 0.0
        for row in range(3):
            by_w[row] = 0.0
            for k in range(3):
                by_w[row] += c2 * (n[row, k] + n[k, row]) * w[k]
                quadratic += w[row] * n[row, k] * w[k]
        alpha = 2.0 * (-0.5 * c1 * (n[0, 0] + n[1, 1] + n[2, 2]) + d1 * (lx * x + ly * y + lz * z) + d2 * quadratic)
        by_w[0] += c1 * lx + alpha * x - (g[2, 1] - g[1, 2])
        by_w[1] += c1 * ly + alpha * y - (g[0, 2] - g[2, 0])
        by_w[2] += c1 * lz + alpha * z - (g[1, 0] - g[0, 1])
        for row in range(3):
            r[row, row] -= 1.0
        for row in range(3):
            for column in range(3):  # (R - I)^T G
                n[row, column] = r[0, row] * g[0, column] + r[1, row] * g[1, column] + r[2, row] * g[2, column]
        by_s[0], by_s[1], by_s[2] = n[0, 0], n[1, 1], n[2, 2]
        by_s[3], by_s[4], by_s[5] = n[1, 2] + n[2, 1], n[0, 2] + n[2, 0], n[0, 1] + n[1, 0]
        for j in range(size):
            amount = 0.0
            for axis in range(3):
                amount += by_w[axis] * turns[p, axis, j]
            for part in range(6):
                amount += by_s[part] * strains[p, part, j]
            push[j] += amount
