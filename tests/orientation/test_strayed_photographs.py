"""A photograph that was matched with a look-alike of its ground returns to where it was recorded."""

from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from flown_block import OFFSET  # type: ignore[import-not-found]

from workbench.orientation.strayed import far_from_recorded, replace_strayed

NAME = "1_2.jpg"
SHIFT = np.array([37.0, 0.0, 0.0])


@pytest.fixture
def strayed(virtual_block):
    """A block with a photograph 37 m off, its true matches, and those with ground that looks alike."""
    block = virtual_block(tie_points=1500)
    model = block.model
    image = model.find_image_with_name(NAME)
    number = image.image_id
    pairs: dict[int, list[tuple[int, int]]] = {}
    pose = image.cam_from_world()
    false = pycolmap.Rigid3d(pose.rotation, pose.translation - pose.rotation * SHIFT)
    observed = [(k, p.point3D_id) for k, p in enumerate(image.points2D) if p.has_point3D()]
    # True matches of a third of its points only; the look-alikes are more.
    for place, point in observed:
        for element in model.point3D(point).track.elements:
            if element.image_id != number and place % 3 == 0:
                pairs.setdefault(element.image_id, []).append((place, element.point2D_idx))
    model.deregister_frame(image.frame_id)
    image.frame.set_cam_from_world(image.camera_id, false)
    model.register_frame(image.frame_id)
    for point in sorted(model.point3D_ids()):
        shown = image.project_point(model.point3D(point).xyz)
        if shown is not None and (shown > 0).all() and (shown < (4000, 3000)).all():
            image.points2D.append(pycolmap.Point2D(shown))
            place = len(image.points2D) - 1
            for element in model.point3D(point).track.elements:
                pairs.setdefault(element.image_id, []).append((place, element.point2D_idx))
            model.add_observation(point, pycolmap.TrackElement(number, place))
    return block, lambda one, other: np.array(pairs.get(other, [])).reshape(-1, 2)


def offset_of(block):
    return block.model.find_image_with_name(NAME).projection_center() + OFFSET - block.poses[NAME].centre


def test_it_is_put_back(strayed):
    block, matches = strayed
    assert list(far_from_recorded(block.model, block.site, OFFSET)[0]) == [NAME]
    assert np.linalg.norm(offset_of(block)) > 30
    assert replace_strayed(block.model, block.site, OFFSET, matches, seed=1) == [NAME]
    assert np.linalg.norm(offset_of(block)) < 0.2
    assert not far_from_recorded(block.model, block.site, OFFSET)[0]
    image = block.model.find_image_with_name(NAME)
    errors = [
        np.linalg.norm(image.project_point(block.model.point3D(p.point3D_id).xyz) - p.xy)
        for p in image.points2D
        if p.has_point3D()
    ]
    assert len(errors) > 50
    assert max(errors) < 3


def test_a_wrong_record_leaves_a_right_pose_alone(virtual_block):
    block = virtual_block()
    site = replace(
        block.site,
        photographs=tuple(
            replace(p, position=tuple(np.add(p.position, SHIFT))) if p.name == NAME else p
            for p in block.site.photographs
        ),
    )
    tracks = [p.track.elements for p in block.model.points3D.values()]

    def matches(one, other):
        found = [
            (a.point2D_idx, b.point2D_idx)
            for track in tracks
            for a in track
            for b in track
            if (a.image_id, b.image_id) == (one, other)
        ]
        return np.array(found).reshape(-1, 2)

    assert list(far_from_recorded(block.model, site, OFFSET)[0]) == [NAME]
    assert replace_strayed(block.model, site, OFFSET, matches, seed=1) == []
    assert np.linalg.norm(offset_of(block)) < 1e-6
