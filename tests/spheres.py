"""A sphere of triangles with the symmetry of the icosahedron: many eigenvalues of it repeat, or nearly so."""

import numpy as np

import modalshell as ms


def icosphere(levels=2):
    """The unit sphere, each triangle of the icosahedron parted in four ``levels`` times."""
    golden = (1.0 + np.sqrt(5.0)) / 2.0
    ring = np.array([(0.0, a, b * golden) for a in (-1, 1) for b in (-1, 1)])
    points = np.vstack([np.roll(ring, k, axis=1) for k in range(3)])
    near = np.linalg.norm(points[:, None] - points, axis=2) < 2.1
    faces = [
        (a, b, c) for a in range(12) for b in range(a) for c in range(b) if near[a, b] and near[b, c] and near[c, a]
    ]
    soup = points[np.array(faces)]
    outward = np.sum(np.cross(soup[:, 1] - soup[:, 0], soup[:, 2] - soup[:, 0]) * soup.sum(axis=1), axis=1) > 0.0
    soup[~outward] = soup[~outward][:, ::-1]
    for _ in range(levels):
        a, b, c = np.moveaxis(soup, 1, 0)
        d, e, f = a + b, b + c, c + a
        soup = np.concatenate(
            [
                np.stack(corners, axis=1)
                for corners in ((a, d / 2, f / 2), (d / 2, b, e / 2), (f / 2, e / 2, c), (d / 2, e / 2, f / 2))
            ]
        )
        soup /= np.linalg.norm(soup, axis=2)[:, :, None]
    soup /= np.linalg.norm(soup, axis=2)[:, :, None]
    corners, faces = np.unique(np.round(soup.reshape(-1, 3), 12), axis=0, return_inverse=True)
    return ms.TriangleMesh(corners / np.linalg.norm(corners, axis=1)[:, None], faces.reshape(-1, 3))
