"""The air between ground and camera: it dims what is seen and adds a bluish veil of its own.

Optical depth of a layer of height h above the ground, per band: molecules (Rayleigh, scale height 8 km)
and aerosol (scale height 1.2 km, Angstrom exponent 1.3) of the visibility that is asked for (Koschmieder:
extinction 3.912 / visibility at 550 nm). The veil is sunlight scattered once (Rayleigh's phase function;
Henyey and Greenstein's with g = 0.65 for aerosol), light of the sky scattered back, and light of the ground
scattered on. From 1 km on a clear day that is 1 % (red) to 2.5 % (blue) of white paper: little on a meadow,
as much as the light itself in the shade of a forest. A drone sees nothing of it.
"""

from __future__ import annotations

import numpy as np

from workbench.virtual.light import Light

VISIBILITY = 40_000.0
"""Metres; a clear day on which one flies."""
_WAVELENGTH = np.array([0.65, 0.55, 0.46, 0.85])  # um, of red, green, blue, near infrared.
_MOLECULES = 0.008735 * _WAVELENGTH**-4.08  # Optical depth of the whole atmosphere.
_MOLECULE_HEIGHT, _AEROSOL_HEIGHT = 8000.0, 1200.0
_ANGSTROM, _ASYMMETRY, _BACKWARD = 1.3, 0.65, 0.15
_GROUND = np.array([0.09, 0.10, 0.08, 0.40])  # Mean reflectance of green land.


def air_of(light: Light, axis: np.ndarray, height: float) -> np.ndarray:
    """Dimming and veil per metre of the way between ground and camera.

    Parameters
    ----------
    light
        Sun and sky.
    axis
        (3,) unit vector along which the camera looks: east, north, up.
    height
        Of the camera above the ground, m.

    Returns
    -------
    ndarray
        (2, 4) float32 for red, green, blue and near infrared: extinction, and radiance of the veil (1 is
        white paper in full light), both per metre.
    """
    molecules = _MOLECULES / _MOLECULE_HEIGHT * _layer(height, _MOLECULE_HEIGHT)
    at_550 = 3.912 / VISIBILITY - _MOLECULES[1] / _MOLECULE_HEIGHT
    aerosol = at_550 * (_WAVELENGTH / 0.55) ** -_ANGSTROM * _layer(height, _AEROSOL_HEIGHT)
    # A photon that went from the sun downwards leaves towards the camera.
    cosine = float(np.dot(light.sun, axis))
    rayleigh = 0.75 * (1 + cosine**2)
    forward = (1 - _ASYMMETRY**2) / (1 + _ASYMMETRY**2 - 2 * _ASYMMETRY * cosine) ** 1.5
    once = np.array(light.direct) / 4 * (rayleigh * molecules + forward * aerosol)
    sky = np.array(light.diffuse)
    again = molecules * 0.5 * (sky + _GROUND) + aerosol * (_BACKWARD * sky + (1 - _BACKWARD) * _GROUND)
    return (np.stack([molecules + aerosol, once + again]) / height).astype(np.float32)


def _layer(height: float, scale: float) -> float:
    """Height of a layer of constant density that holds as much as the real one, m."""
    return float(scale * -np.expm1(-height / scale))
