import cv2
import numpy as np
import pytest
from box_scene import ORIGIN, UTM, BoxSite, box_surface, render

from workbench.cameras import Camera, Pose
from workbench.orientation import Block, OrientedPhotograph


@pytest.fixture(scope="session")
def box_site(tmp_path_factory) -> BoxSite:
    """Nine photographs in three strips, one of them a third brighter, one taken upside down."""
    folder = tmp_path_factory.mktemp("box")
    camera = Camera.from_focal_length(
        "test", 600, 450, focal_length=0.02, pixel_size=3.6e-5, distortion=(-0.06, 0.02, 0.001, -0.0005)
    )
    photographs = []
    for strip, y in enumerate((15.0, 35.0, 55.0)):
        for order, x in enumerate((12.0, 33.0, 55.0)):
            name = f"photo_{strip}{order}.png"
            centre = np.array([*(ORIGIN + (x, y)), 60.0])
            heading = 90.0 if strip != 1 else 270.0
            pose = Pose.from_roll_pitch_heading(centre, 2.0 * order - 2, 1.5 - strip, heading)
            image = render(camera, pose, gain=0.7 if name == "photo_11.png" else 1.0)
            cv2.imwrite(str(folder / name), image[..., ::-1])
            photographs.append(OrientedPhotograph(name, folder / name, camera, pose, strip, order))
    return BoxSite(Block(tuple(photographs), UTM, "test"), box_surface(), folder)
