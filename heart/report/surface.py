"""Surfaces of tetrahedral meshes and their pictures: seen from far away, painted from back to front by matplotlib."""

import numpy as np
from matplotlib.collections import PolyCollection

# The faces of a positively oriented tetrahedron, normals outwards.
FACES = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))
EDGES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))
GREY = (0.80, 0.80, 0.80)
CREASE_COSINE = 0.8  # neighbours that meet at a sharper angle are not shaded as one smooth surface


class Patches:
    """Loose triangles: corners (n, 3, columns) with x, y, z in m and the value to show; False in `coloured`: none."""

    def __init__(self, corners, coloured):
        self.corners, self.coloured = corners, coloured

    def take(self, chosen):
        return Patches(self.corners[chosen], self.coloured[chosen])

    def values(self):
        return self.corners[:, :, 3]


def joined(parts):
    return Patches(np.concatenate([p.corners for p in parts]), np.concatenate([p.coloured for p in parts]))


def boundary(cells):
    """Triangles that belong to one tetrahedron only, normals outwards, and the tetrahedron of each."""
    faces = cells[:, FACES].reshape(-1, 3)
    owner = np.repeat(np.arange(len(cells)), 4)
    key = np.sort(faces, axis=1)
    order = np.lexsort(key.T)
    same = np.all(key[order][1:] == key[order][:-1], axis=1)
    alone = np.ones(len(faces), bool)
    alone[order[1:][same]] = False
    alone[order[:-1][same]] = False
    return faces[alone], owner[alone]


def outer_patches(points, cells, values, coloured_cells):
    """The boundary of the body; `coloured_cells` says which tetrahedra show values."""
    triangles, owner = boundary(cells)
    return Patches(np.column_stack((points, values))[triangles], coloured_cells[owner])


def above(patches, height):
    """The part of the patches where the height, given at their corners (n, 3), is positive."""
    n_above = (height > 0).sum(axis=1)
    parts = [patches.take(n_above == 3)]
    for wanted in (1, 2):
        chosen = np.flatnonzero(n_above == wanted)
        # Turn each triangle so that the corner that is alone on its side comes first.
        alone = np.argmax((height[chosen] > 0) == (wanted == 1), axis=1)
        turned = (alone[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(patches.corners[chosen[:, None], turned], 1, 0)
        h = height[chosen[:, None], turned]
        ab = a + (h[:, 0] / (h[:, 0] - h[:, 1]))[:, None] * (b - a)
        ac = a + (h[:, 0] / (h[:, 0] - h[:, 2]))[:, None] * (c - a)
        for triangle in ((a, ab, ac),) if wanted == 1 else ((ab, b, c), (ab, c, ac)):
            parts.append(Patches(np.stack(triangle, axis=1), patches.coloured[chosen]))
    return joined(parts)


def clipped(patches, origin, normal):
    """The part of the patches on the side of the plane to which `normal` points."""
    return above(patches, (patches.corners[:, :, :3] - origin) @ normal)


def split_at(patches, levels):
    """The patches cut along lines of equal value, so that each lies between two levels."""
    parts = [patches.take(~patches.coloured)]
    rest = patches.take(patches.coloured)
    for level in levels:
        parts.append(rest.take((rest.values() == level).all(axis=1)))
        parts.append(above(rest, level - rest.values()))
        rest = above(rest, rest.values() - level)
    return joined([*parts, rest])


def section(points, cells, values, coloured_cells, origin, normal):
    """The cut face of the body in the plane; its normals point out of what `clipped` keeps."""
    height = (points - origin) @ normal
    is_above = height[cells] > 0
    crossed = is_above.any(axis=1) & ~is_above.all(axis=1)
    cells, is_above, coloured = cells[crossed], is_above[crossed], coloured_cells[crossed]
    nodes = np.column_stack((points, values))
    corners = np.full((len(cells), 6, 4), np.nan)
    for k, (a, b) in enumerate(EDGES):
        cut = is_above[:, a] != is_above[:, b]
        i, j = cells[cut, a], cells[cut, b]
        share = height[i] / (height[i] - height[j])
        corners[cut, k] = nodes[i] + share[:, None] * (nodes[j] - nodes[i])
    # Three or four edges are cut: order the corners around their middle, then make a fan of triangles.
    there = np.isfinite(corners[:, :, 3])
    middle = np.where(there[:, :, None], corners, 0).sum(axis=1) / there.sum(axis=1)[:, None]
    u = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    u /= np.linalg.norm(u)
    away = (corners - middle[:, None])[:, :, :3]
    angle = np.arctan2(away @ u, away @ np.cross(normal, u))  # clockwise about `normal`; absent corners sort last
    corners = np.take_along_axis(corners, np.argsort(angle, axis=1)[:, :, None], axis=1)
    four = there.sum(axis=1) == 4
    return joined([Patches(corners[:, :3], coloured), Patches(corners[four][:, [0, 2, 3]], coloured[four])])


def refined(patches, largest_edge):
    """Triangles split until no edge is longer: colours follow the values inside, and order by depth holds better."""
    X = patches.corners[:, :, :3]
    edges = np.linalg.norm(X - np.roll(X, 1, axis=1), axis=2).max(axis=1, initial=0)
    pieces = np.clip(np.ceil(edges / largest_edge), 1, 16).astype(int)
    parts = [patches.take(pieces == 1)]
    for n in range(2, 17):
        chosen = patches.take(pieces == n)
        small = [[(i, j), (i + 1, j), (i, j + 1)] for i in range(n) for j in range(n - i)]
        small += [[(i + 1, j), (i + 1, j + 1), (i, j + 1)] for i in range(n - 1) for j in range(n - 1 - i)]
        share = np.array(small, float) / n  # small triangles x corners x (second, third corner of the large one)
        share = np.concatenate((1 - share.sum(axis=2, keepdims=True), share), axis=2)
        corners = np.einsum("sck,tkx->tscx", share, chosen.corners).reshape(-1, 3, patches.corners.shape[2])
        parts.append(Patches(corners, np.repeat(chosen.coloured, len(share))))
    return joined(parts)


class Camera:
    """Looks from far away; z is up in the picture. Angles in degrees, azimuth from x towards y."""

    def __init__(self, azimuth, elevation):
        self.azimuth = azimuth
        a, e = np.radians(azimuth), np.radians(elevation)
        self.towards = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        self.right = np.array([-np.sin(a), np.cos(a), 0])
        self.up = np.cross(self.towards, self.right)
        light = 0.85 * self.towards + 0.35 * self.up - 0.4 * self.right
        self.light = light / np.linalg.norm(light)

    def flat_mm(self, points):
        return 1e3 * np.stack((points @ self.right, points @ self.up), axis=-1)


def _area_normals(patches):
    a, b, c = np.moveaxis(patches.corners[:, :, :3], 1, 0)
    return np.cross(b - a, c - a)


def _brightness(patches, camera):
    """At each corner, from the mean normal of the patches that meet there without a crease."""
    area = _area_normals(patches)
    normal = area / np.maximum(np.linalg.norm(area, axis=1), 1e-300)[:, None]
    _, corner = np.unique(np.round(patches.corners[:, :, :3].reshape(-1, 3), 9), axis=0, return_inverse=True)
    # Corners of one point stand together once sorted: compare each with those 1, 2, 3 ... places on.
    order = np.argsort(corner.reshape(-1), kind="stable")
    corner = corner.reshape(-1)[order]
    area, normal = np.repeat(area, 3, axis=0)[order], np.repeat(normal, 3, axis=0)[order]
    mean = area.copy()
    step = 1
    while (first := np.flatnonzero(corner[step:] == corner[:-step])).size:
        other = first + step
        smooth = np.einsum("cx,cx->c", normal[first], normal[other]) > CREASE_COSINE
        first, other = first[smooth], other[smooth]
        mean[first] += area[other]
        mean[other] += area[first]
        step += 1
    mean /= np.maximum(np.linalg.norm(mean, axis=1), 1e-300)[:, None]
    light = np.empty(len(mean))
    light[order] = mean @ camera.light
    light = light.reshape(-1, 3)
    return 0.62 + 0.38 * np.clip(light, 0, 1)


def draw(axis, patches, camera, norm, colours, largest_edge, levels=()):
    """Draws the patches in mm, over what is there; with `levels`, in bands of one colour between them."""
    brightness = _brightness(patches, camera)
    patches = Patches(np.concatenate((patches.corners, brightness[:, :, None]), axis=2), patches.coloured)
    area = _area_normals(patches)
    patches = patches.take(area @ camera.towards > 1e-3 * np.linalg.norm(area, axis=1))
    patches = refined(split_at(patches, levels), largest_edge)
    patches = patches.take(np.argsort(patches.corners[:, :, :3].mean(axis=1) @ camera.towards, kind="stable"))
    rgb = colours(norm(patches.values().mean(axis=1)))[:, :3]
    rgb[~patches.coloured] = GREY
    rgb *= patches.corners[:, :, 4].mean(axis=1)[:, None]
    # Thin edges close the seams between neighbours.
    axis.add_collection(PolyCollection(camera.flat_mm(patches.corners[:, :, :3]), facecolors=rgb, edgecolors=rgb,
                                       linewidths=0.3, antialiaseds=False))
