"""The four functions in NumPy float64, written from what is published of them (Laine et al. 2020; nvdiffrast's manual), loop by loop, to
compare with. Shapes as in dressi_edge/primitives/torch.py, without batches but for the first axis."""
import numpy as np


def cross(a, b):
    """Of vectors in the plane."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def projected(pos, height, width):
    """Screen positions of (V, 4) clip coordinates from the first row and column."""
    return (pos[:, :2] / pos[:, 3:] + 1) / 2 * [width, height]


def rasterize(pos, tri, height, width):
    """rast, db (n, h, w, 4), and where no triangle's edge is nearer than 1/64 pixel to the centre, and no two are equally deep."""
    n = len(pos)
    rast, db, sure = np.zeros((n, height, width, 4)), np.zeros((n, height, width, 4)), np.ones((n, height, width), bool)
    ys, xs = np.mgrid[:height, :width] + 0.5
    for k in range(n):
        best = np.full((height, width), np.inf)
        for t, f in enumerate(tri):
            p = pos[k, f]
            if (p[:, 3] <= 0).any():
                raise ValueError("a corner behind the camera")
            q = projected(p, height, width)
            e = [cross(q[b] - q[a], np.stack([xs - q[a, 0], ys - q[a, 1]], -1)) for a, b in ((1, 2), (2, 0), (0, 1))]
            area = cross(q[1] - q[0], q[2] - q[0])
            if area == 0:
                continue
            flat = np.stack(e, -1) / area  # on screen
            lengths = [np.linalg.norm(q[b] - q[a]) for a, b in ((1, 2), (2, 0), (0, 1))]
            far = np.min([x * abs(area) / s for x, s in zip(np.moveaxis(flat, -1, 0), lengths)], 0)
            sure[k] &= np.abs(far) > 1 / 64
            w = flat / p[:, 3]
            bary = w / w.sum(-1, keepdims=True)
            z = flat @ (p[:, 2] / p[:, 3])
            inside = (flat >= 0).all(-1) & (z >= -1) & (z <= 1)
            sure[k] &= ~(inside & (np.abs(z - best) < 1e-6))
            shown = inside & (z < best)
            best[shown] = z[shown]
            rast[k][shown] = np.concatenate([bary[..., :2], z[..., None], np.full_like(z, t + 1)[..., None]], -1)[shown]
            d = [np.array([-(q[b] - q[a])[1], (q[b] - q[a])[0]]) / area for a, b in ((1, 2), (2, 0), (0, 1))]  # of flat, by x and y
            dw = [x / w3 for x, w3 in zip(d, p[:, 3])]
            total = w.sum(-1)
            change = [(dw[i][j] - bary[..., i] * sum(x[j] for x in dw)) / total for i in (0, 1) for j in (0, 1)]
            db[k][shown] = np.stack(change, -1)[shown]
    return rast, db, sure


def interpolate(attr, rast, tri, db=None):
    """out, and of all channels d/dX, d/dY side by side."""
    n, height, width, _ = rast.shape
    out, da = np.zeros((n, height, width, attr.shape[-1])), np.zeros((n, height, width, attr.shape[-1], 2))
    for k, y, x in np.argwhere(rast[..., 3] > 0):
        a = attr[k if len(attr) > 1 else 0][tri[int(rast[k, y, x, 3]) - 1]]
        u, v = rast[k, y, x, :2]
        out[k, y, x] = u * a[0] + v * a[1] + (1 - u - v) * a[2]
        if db is not None:
            dudx, dudy, dvdx, dvdy = db[k, y, x]
            da[k, y, x] = np.stack([dudx * (a[0] - a[2]) + dvdx * (a[1] - a[2]), dudy * (a[0] - a[2]) + dvdy * (a[1] - a[2])], -1)
    return out, da.reshape(n, height, width, -1)


def texture(tex, uv, filter_mode, boundary_mode):
    """tex (1, h, w, c), uv (n, H, W, 2)."""
    _, h, w, c = tex.shape

    def texel(y, x):
        if boundary_mode == "zero" and not (0 <= x < w and 0 <= y < h):
            return np.zeros(c)
        return tex[0, y % h, x % w] if boundary_mode == "wrap" else tex[0, np.clip(y, 0, h - 1), np.clip(x, 0, w - 1)]

    out = np.zeros((*uv.shape[:3], c))
    for at in np.ndindex(uv.shape[:3]):
        x, y = uv[at] * [w, h]
        if filter_mode == "nearest":
            out[at] = texel(int(np.floor(y)), int(np.floor(x)))
            continue
        i, j = int(np.floor(x - 0.5)), int(np.floor(y - 0.5))
        fx, fy = x - 0.5 - i, y - 0.5 - j
        out[at] = ((texel(j, i) * (1 - fx) + texel(j, i + 1) * fx) * (1 - fy)
                   + (texel(j + 1, i) * (1 - fx) + texel(j + 1, i + 1) * fx) * fy)
    return out


def antialias(color, rast, pos, tri):
    """For each pair of neighbours of different triangles: the one in front; of its silhouette edges the one that crosses between the two
    centres last; of the pixel that lies beyond the middle from it, that much of the other's colour."""
    out = np.array(color)
    n, height, width, _ = color.shape
    across = {}
    for f in np.asarray(tri).tolist():
        for k in range(3):
            across.setdefault(frozenset((f[(k + 1) % 3], f[(k + 2) % 3])), []).append(f[k])
    for k, y, x in np.ndindex(n, height, width):
        for dx, dy in ((1, 0), (0, 1)):
            if x + dx >= width or y + dy >= height:
                continue
            here, there = rast[k, y, x], rast[k, y + dy, x + dx]
            if here[3] == there[3]:
                continue
            own = there[3] == 0 or (here[3] != 0 and here[2] < there[2])
            f = np.asarray(tri)[int((here if own else there)[3]) - 1]
            centre = np.array([x, y]) + 0.5 + (0 if own else np.array([dx, dy]))
            q = projected(pos[k], height, width) - centre
            turn = cross(q[f[1]] - q[f[0]], q[f[2]] - q[f[0]])
            found = []
            for i in range(3):
                a, b = f[(i + 1) % 3], f[(i + 2) % 3]
                p, r = (q[a], q[b]) if dx else (q[a][::-1], q[b][::-1])  # first along the way between the centres, then across it
                if (p[1] < 0) == (r[1] < 0):
                    continue
                way = (p[0] - p[1] * (r[0] - p[0]) / (r[1] - p[1])) * (1 if own else -1)
                others = [v for v in across[frozenset((a, b))] if v != f[i]]
                fold = not others or (cross(q[a] - q[others[0]], q[b] - q[others[0]]) < 0) == (turn < 0)
                found.append((way, fold and abs(r[1] - p[1]) >= abs(r[0] - p[0])))
            if not found:
                continue
            way, right = max(found)
            if right and -1 / 16 < way < 1 + 1 / 16:
                alpha = (1 if own else -1) * (0.5 - np.clip(way, 0, 1))
                target = (k, y, x) if alpha > 0 else (k, y + dy, x + dx)
                out[target] += alpha * (color[k, y + dy, x + dx] - color[k, y, x])
    return out
