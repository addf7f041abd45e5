"""Surfaces of a photograph: land, lake and hard bodies."""

from __future__ import annotations

import math

import numpy as np

from workbench.virtual.above import NOTHING, SOLID
from workbench.virtual.compiled import inner, kernel
from workbench.virtual.particles import ground_height
from workbench.virtual.shade import (
    ground_colour,
    ground_cover,
    ground_taps,
    place_hash,
    plain_cover,
    solid_colour,
    sunlit_ground,
    target_colour,
)
from workbench.virtual.solids import hit_solid
from workbench.virtual.views import canopy_shade, towards
from workbench.virtual.water import lake_at, shade_water
from workbench.virtual.world import Cover


@kernel
def paint_solids(world, textures, light, view, scale, chosen, tile):
    """Bodies that are nearer than what a subpixel shows so far."""
    rows, columns = tile.depth.shape
    ox, oy, oz = view.centre
    base = np.zeros(4, dtype=np.float32)
    for body, i0, i1, j0, j1 in chosen:
        for i in range(max(i0 - tile.row, 0), min(i1 - tile.row, rows)):
            for j in range(max(j0 - tile.column, 0), min(j1 - tile.column, columns)):
                dx = tile.place[i, j, 0] - ox
                dy = tile.place[i, j, 1] - oy
                dz = tile.place[i, j, 2] - oz
                enter, leave, plane = hit_solid(world.solids, body, ox, oy, oz, dx, dy, dz)
                if enter >= leave or enter <= 0:
                    continue
                m = view.rotation
                reach = m[2, 0] * dx + m[2, 1] * dy + m[2, 2] * dz
                depth = np.float32(enter * reach)
                if depth >= tile.depth[i, j]:
                    continue
                x, y, z = ox + enter * dx, oy + enter * dy, oz + enter * dz
                nx, ny, nz, _ = world.solids.planes[plane]
                footprint = np.float32(depth * scale)
                solid_colour(world, textures, body, plane, x, y, z, footprint, base)
                facing = nx * light.sun[0] + ny * light.sun[1] + nz * light.sun[2]
                lit = np.float32(0)
                if facing > 0:
                    # Off the face by a cell of the shadow map, so that it does not shade itself.
                    off = 1.5 * light.cell
                    lit = np.float32(facing) * sunlit_ground(
                        light,
                        np.float32(x + off * nx),
                        np.float32(y + off * ny),
                        np.float32(z + off * max(nz, 0.0) + 0.05),
                        place_hash(x + z, y),
                    )
                sky = np.float32(0.5 + 0.5 * nz)
                for band in range(4):
                    tile.colour[i, j, band] = base[band] * (
                        light.direct[band] * lit + light.diffuse[band] * sky
                    )
                tile.depth[i, j] = depth
                tile.owner[i, j] = SOLID - body


@kernel
def paint_ground(world, textures, light, waves, view, scale, s, cover, tile):
    """Land and lake where nothing stands in front; ``cover`` receives their codes.

    What changes slowly (slope, share of the sky, nearness of a target) is found once a pixel, the rest
    for each of its ``s`` x ``s`` subpixels.
    """
    rows, columns = tile.depth.shape
    base = np.zeros(4, dtype=np.float32)
    lake = lake_at(world, textures, waves, np.float32(0), np.float32(0), np.float32(1))
    for top in range(0, rows, s):
        for left in range(0, columns, s):
            bare = 0
            for i in range(top, top + s):
                for j in range(left, left + s):
                    bare += tile.owner[i, j] == NOTHING
            if bare == 0:
                continue
            x, y, z = tile.place[top, left, 0], tile.place[top, left, 1], tile.place[top, left, 2]
            xf, yf = np.float32(x), np.float32(y)
            facing = _facing(world.terrain, light, xf, yf)
            sky = canopy_shade(world, xf, yf, np.float32(z))
            toward = towards(view, x, y, z)
            footprint = np.float32(tile.depth[top, left] * scale)
            taps = ground_taps(textures, footprint)
            signal = _target_near(world, x, y, s * footprint)
            if z <= world.water_level + s * footprint:
                lake = lake_at(world, textures, waves, xf, yf, footprint)
            plain = plain_cover(world, xf, yf, np.float32(z)) if s * footprint < 0.2 else -1
            for i in range(top, top + s):
                for j in range(left, left + s):
                    if tile.owner[i, j] != NOTHING:
                        continue
                    x, y, z = tile.place[i, j, 0], tile.place[i, j, 1], np.float32(tile.place[i, j, 2])
                    xf, yf = np.float32(x), np.float32(y)
                    lit = sunlit_ground(light, xf, yf, z, place_hash(x, y))
                    code = plain
                    level_here = z <= world.water_level + 1e-3
                    if code < 0 and level_here and ground_height(world.terrain, xf, yf) < world.water_level:
                        code = Cover.WATER.value
                    if code == Cover.WATER.value:
                        shade_water(light, textures, lake, xf, yf, toward, lit, base)
                        cover[i, j] = code
                        for band in range(4):
                            tile.colour[i, j, band] = base[band]
                        continue
                    if signal and target_colour(world, x, y, base, footprint):
                        code = Cover.TARGET.value
                    else:
                        if code < 0:
                            code = ground_cover(world, textures, xf, yf, z, taps)
                        ground_colour(textures, code, xf, yf, taps, base)
                    cover[i, j] = code
                    for band in range(4):
                        incoming = light.direct[band] * facing * lit + light.diffuse[band] * sky
                        tile.colour[i, j, band] = base[band] * incoming


@inner
def _facing(terrain, light, x, y):
    """Cosine between the normal of the terrain and the sun, not below 0."""
    step = terrain.step
    east = ground_height(terrain, x + step, y) - ground_height(terrain, x - step, y)
    north = ground_height(terrain, x, y + step) - ground_height(terrain, x, y - step)
    gx, gy = -east / (2 * step), -north / (2 * step)
    cosine = (gx * light.sun[0] + gy * light.sun[1] + light.sun[2]) / math.sqrt(gx * gx + gy * gy + 1)
    return np.float32(max(cosine, 0.0))


@inner
def _target_near(world, x, y, margin):
    """Whether a target lies within its size and a margin of a place."""
    for k in range(world.targets.shape[0]):
        reach = world.targets[k, 2] + margin
        if abs(x - world.targets[k, 0]) < reach and abs(y - world.targets[k, 1]) < reach:
            return True
    return False
