"""Reference of derivatives by complex steps: explicit sums over samples that share no code with ``warpdiff``.

A real parameter p becomes p + i·STEP, and the derivative is the imaginary part of the result over STEP, exact up to
rounding. Complex quantities of the physics are pairs of numbers (real part, imaginary part), because the imaginary unit
belongs to the step.

(u, v, w) is the scattering vector. κ is w/λ, its normal component divided by the wavelength.
"""

import numpy as np

STEP = 1e-30
HORIZON = 1e-6
RISEN = 0.1


def product(a, b):
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]


def matrix_product(a, b):
    return a[0] @ b[0] - a[1] @ b[1], a[0] @ b[1] + a[1] @ b[0]


def total(a, b):
    return a[0] + b[0], a[1] + b[1]


def difference(a, b):
    return a[0] - b[0], a[1] - b[1]


def quotient(a, b):
    size = b[0] ** 2 + b[1] ** 2
    return product(a, (b[0] / size, -b[1] / size))


def root(a):
    """Return the square root of a complex number, given as a pair. The real part of the root is positive."""
    size = np.sqrt(a[0] ** 2 + a[1] ** 2)
    real = np.sqrt((size + a[0]) / 2)
    return real, a[1] / (2 * real)


def phase(x):
    return np.cos(x), np.sin(x)


def power(a):
    return a[0] ** 2 + a[1] ** 2


def smaller(a, b):
    return a if np.real(a) <= np.real(b) else b


def dot(a, b):
    return (a * b).sum()


def unit(v):
    return v / np.sqrt(dot(v, v))


def schlick(cosine, ior):
    if ior == np.inf:
        return 1.0
    normal = ((ior - 1) / (ior + 1)) ** 2
    return normal + (1 - normal) * (1 - cosine) ** 5


def film_reflectance(cosine, indices, film_nm, wavelength_nm):
    """Return the unpolarised reflectance of a material, with or without a film, in air.

    ``indices`` are the indices of refraction of the film, if there is one, and of the material, as pairs (real part,
    imaginary part).
    """
    along2 = 1 - cosine * cosine
    media = [(1.0 + 0 * cosine, 0 * cosine), *indices]
    angles = [(cosine, 0 * cosine)]
    for index in indices:
        sine2 = quotient((along2, 0 * along2), product(index, index))
        angles.append(root((1 - sine2[0], -sine2[1])))
    result = 0.0
    for polarisation in "sp":
        amplitudes = []
        for j in range(len(indices)):
            a, b = (j, j + 1) if polarisation == "s" else (j + 1, j)
            first, second = product(media[a], angles[j]), product(media[b], angles[j + 1])
            amplitudes.append(quotient(difference(first, second), total(first, second)))
        r = amplitudes[0]
        if len(indices) == 2:
            path = product(indices[0], angles[1])
            turns = 4 * np.pi * film_nm / wavelength_nm
            decay = np.exp(-turns * path[1])
            wave = phase(turns * path[0])
            behind = product(amplitudes[1], (decay * wave[0], decay * wave[1]))
            inner = product(r, behind)
            r = quotient(total(r, behind), (1 + inner[0], inner[1]))
        result = result + power(r) / 2
    return result


def amplitudes(heights, kappa, s, r):
    """Return the Fourier coefficients of exp(2πiκh) for heights h of ny × nx samples, as a pair of matrices.

    A coefficient is (1/N) Σ exp(2πiκh) exp(2πi(sj/ny + rk/nx)). The sum is over the N samples with row j and column k.
    The matrices have one row for each value in ``s`` and one column for each value in ``r``.
    """
    ny, nx = heights.shape
    along_y = phase(2 * np.pi * (np.outer(s, np.arange(ny)) % ny) / ny)
    along_x = phase(2 * np.pi * (np.outer(np.arange(nx), r) % nx) / nx)
    field = matrix_product(matrix_product(along_y, phase(2 * np.pi * kappa * heights)), along_x)
    return field[0] / heights.size, field[1] / heights.size


def reflectance_of(optics, cosine, wavelength_nm):
    if optics.get("indices") is None:
        return schlick(cosine, optics["ior"])
    return film_reflectance(cosine, optics["indices"], optics.get("film_nm", 0.0), wavelength_nm)


def spectral_reflectance(p, kind, wavelength_nm, *, masking, widths=11.0):
    """Return the relative reflectance ρ at one wavelength, for the parameters ``p`` (surface and directions).

    The result is a sum over Fourier coefficients, each weighted by a Gaussian of its distance from (u, v)/λ. The sum
    includes distances up to ``widths`` standard deviations of the Gaussian.
    """
    heights = p["heights_um"] * p.get("height_scale", 1.0)
    ny, nx = heights.shape
    pitch = p["pitch_um"]
    size = ny * pitch[0], nx * pitch[1]
    light, view = unit(p["to_light"]), unit(p["to_view"])
    wavelength = wavelength_nm * 1e-3
    u = -(light + view)
    q, kappa = u[:2] / wavelength, u[2] / wavelength
    overlap = 1 + dot(light, view)
    height = light[2] + view[2]
    gain = (overlap / height) ** 2 / view[2]
    if masking:
        gain = gain * smaller(1.0, 2 * height * smaller(light[2], view[2]) / overlap)
    if kind == "source":
        gain = gain / light[2]
    gain = gain * reflectance_of(p, np.sqrt(overlap / 2), wavelength_nm)
    if p.get("indices") is None:
        gain = gain / schlick(1.0, p["ior"])
    if kind == "replicas":
        along_y = phase(2 * np.pi * q[1] * pitch[0] * np.arange(ny)[None])
        along_x = phase(2 * np.pi * q[0] * pitch[1] * np.arange(nx)[:, None])
        field = matrix_product(matrix_product(along_y, phase(2 * np.pi * kappa * heights)), along_x)
        factor = 1.0
        for turns, count in ((q[1] * size[0], p["periods"][0]), (q[0] * size[1], p["periods"][1])):
            part = np.pi * (turns - round(np.real(turns)))
            factor = factor * (np.sin(count * part) / (count * np.sin(part))) ** 2
        return (gain * power(field) * factor / heights.size**2)[0, 0]
    xx = yy = (4 if kind == "averaged" else 2) * (np.pi * p.get("sigma_um", 0.0)) ** 2
    xy = 0.0
    if kind == "source":
        spread = p["angular_diameter_deg"] / 2 * np.pi / 180 / np.sqrt(2)
        falloff = wavelength**2 / (2 * spread**2)
        x, y = light[0] / light[2], light[1] / light[2]
        xx, xy, yy = falloff * (1 + x * x), falloff * x * y, falloff * (1 + y * y)
        least = falloff
    else:
        least = xx
    reach = widths / np.sqrt(2 * np.real(least))
    orders = []
    for axis, count in ((1, ny), (0, nx)):
        centre, length = np.real(q[axis]), np.real(size[1 - axis])
        m = np.arange(np.ceil((centre - reach) * length), np.floor((centre + reach) * length) + 1)
        orders.append(m if count > 1 else np.zeros(1))
    s, r = orders
    field = amplitudes(heights, kappa, s, r)
    dx, dy = (q[0] - r / size[1])[None], (q[1] - s / size[0])[:, None]
    weights = np.exp(-(xx * dx * dx + 2 * xy * dx * dy + yy * dy * dy))
    if kind == "centred":
        centre = p.get("centre_um")
        turns = [(ny // 2) / ny, (nx // 2) / nx] if centre is None else [centre[0] / size[0], centre[1] / size[1]]
        field = product(field, phase(-2 * np.pi * (s[:, None] * turns[0] + r[None] * turns[1])))
        return gain * ((field[0] * weights).sum() ** 2 + (field[1] * weights).sum() ** 2)
    return gain * (power(field) * weights).sum()


def rise(cosine):
    share = smaller(cosine / RISEN, 1.0)
    return share * share * (3 - 2 * share)


def order_efficiencies(p, orders, wavelength_nm, *, normalised):
    """Return the efficiencies of orders (m_y, m_x), all of which propagate.

    Normalised efficiencies have prescribed sums over orders and over incident directions. They are computed from a
    matrix of efficiencies, with one row per incident direction and one column per order. Its rows and columns are
    scaled alternately to these sums, 3,000 times.
    """
    heights = p["heights_um"] * p.get("height_scale", 1.0)
    ny, nx = heights.shape
    size = ny * p["pitch_um"][0], nx * p["pitch_um"][1]
    light, wavelength = unit(p["to_light"]), wavelength_nm * 1e-3

    def upward(x, y):
        return np.array([x, y, np.sqrt(1 - x * x - y * y)])

    def mirror(e, v, m):
        height = e[2] + v[2]
        field = amplitudes(heights, -height / wavelength, np.array([m[0]]), np.array([m[1]]))
        return power(field)[0, 0] * (1 + dot(e, v)) ** 2 / (e[2] * v[2] * height**2)

    views = [upward(m[1] * wavelength / size[1] - light[0], m[0] * wavelength / size[0] - light[1]) for m in orders]
    values = np.array([mirror(light, v, (-m[0], -m[1])) for m, v in zip(orders, views, strict=True)])
    if normalised:
        lights, shifts = [], []
        reach = [
            int(2 * np.real(length) / np.real(wavelength)) + 2 if n > 1 else 0
            for length, n in zip(size, (ny, nx), strict=True)
        ]
        for a in range(-reach[0], reach[0] + 1):
            for b in range(-reach[1], reach[1] + 1):
                x, y = light[0] + b * wavelength / size[1], light[1] + a * wavelength / size[0]
                if np.real(1 - x * x - y * y) > HORIZON**2:
                    lights.append(upward(x, y))
                    shifts.append((a, b))
        matrix = np.array(
            [
                [mirror(e, v, (-(t[0] + m[0]), -(t[1] + m[1]))) for m, v in zip(orders, views, strict=True)]
                for e, t in zip(lights, shifts, strict=True)
            ]
        )
        rows, columns = np.array([rise(e[2]) for e in lights]), np.array([rise(v[2]) for v in views])
        second = np.ones(len(orders))
        for _ in range(3000):
            first = rows / (matrix @ second)
            second = columns / (matrix.T @ first)
        own = shifts.index((0, 0))
        values = rows[own] / (matrix[own] @ second) * second * matrix[own]
        values = values + np.array([(1 - rows[own]) * (tuple(m) == (0, 0)) for m in orders])
    cosines = [np.sqrt((1 + dot(light, v)) / 2) for v in views]
    return np.array([value * reflectance_of(p, c, wavelength_nm) for value, c in zip(values, cosines, strict=True)])


def derivative(function, p, name, index=None):
    """Return the derivative of ``function(p)`` with respect to one element of the parameter ``name``."""
    changed = dict(p)
    if index is None:
        changed[name] = p[name] + 1j * STEP
    else:
        array = np.array(p[name], dtype=complex)
        array[index] += 1j * STEP
        changed[name] = array
    return np.imag(function(changed)) / STEP
