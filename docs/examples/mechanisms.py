"""The pictures of the shipped mechanisms in docs/devices-and-mechanisms.md, from their MJCF.

    MUJOCO_GL=egl python docs/examples/mechanisms.py        # or MUJOCO_GL=glfw on a desktop

Writes docs/mechanism-*.png: both sides apart, the active one below; cone and drogue are seen
through.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
WIDTH, HEIGHT, SMOOTH = 880, 600, 2  # [pixels], and how many of them are averaged a side
COLORS = 128  # of the picture's palette
BRIGHT = [0.96, 0.97, 0.98]


class View(NamedTuple):
    """How a mechanism is looked at: ``gap`` [m] between A and P, ``aim`` (3,) [m] from P,
    ``distance`` [m], angles [deg].
    """

    gap: float
    aim: tuple[float, float, float]
    distance: float
    azimuth: float
    elevation: float
    glass: tuple[str, ...] = ()  # materials of the passive side that are seen through


VIEWS = {
    "bumper": View(0.16, (0.0, 0.0, -0.12), 2.0, 100.0, -10.0),
    "probe_cone": View(0.16, (0.0, 0.0, -0.22), 1.9, 100.0, -8.0, glass=("passive_shell",)),
    "idss_ring": View(0.45, (0.0, 0.0, -0.34), 2.45, 100.0, -13.0),
    "probe_drogue": View(0.16, (0.0, 0.0, -0.25), 1.75, 100.0, -6.0, glass=("passive_shell",)),
    "marman_gripper": View(0.34, (0.0, 0.0, -0.22), 2.15, 105.0, -15.0),
    "kinematic_coupling": View(0.22, (0.0, 0.0, -0.16), 1.7, 100.0, -10.0),
}


def composed(name: str, view: View) -> mujoco.MjModel:
    """Both sides of a mechanism, P at the origin, A below it."""
    spec = mujoco.MjSpec()
    glob = spec.visual.global_
    glob.offwidth, glob.offheight = WIDTH * SMOOTH, HEIGHT * SMOOTH
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.42] * 3, [0.35] * 3
    quality = spec.visual.quality
    quality.offsamples, quality.numslices, quality.numstacks = 8, 96, 48
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        rgb1=BRIGHT,
        rgb2=BRIGHT,
        width=16,
        height=96,
    )
    for pos, strength in (([1.5, 2.5, 1.5], 0.5), ([-2.5, 1.0, -0.5], 0.25)):
        light = spec.worldbody.add_light(
            pos=pos, dir=[-p for p in pos], diffuse=[strength] * 3, specular=[0.2] * 3
        )
        light.castshadow = False
    for side, port, height in (("passive", "P", 0.0), ("active", "A", -view.gap)):
        file = ROOT / "models" / name / f"{side}.xml"
        part = mujoco.MjSpec.from_file(str(file))
        at = np.array([0.0, 0.0, height]) - np.array(part.site(port).pos)
        spec.attach(part, prefix=f"{side}_", frame=spec.worldbody.add_frame(pos=at))
    for material in view.glass:
        spec.material(material).rgba[3] = 0.45
    return spec.compile()


def picture(name: str, view: View) -> Image.Image:
    """What the camera sees."""
    model = composed(name, view)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera = mujoco.MjvCamera()
    camera.lookat[:], camera.distance, camera.azimuth, camera.elevation = (
        view.aim,
        view.distance,
        view.azimuth,
        view.elevation,
    )
    option = mujoco.MjvOption()
    option.geomgroup[:], option.sitegroup[:] = [1, 1, 1, 0, 0, 0], 0  # 3: what only collides
    with mujoco.Renderer(model, HEIGHT * SMOOTH, WIDTH * SMOOTH) as renderer:
        renderer.update_scene(data, camera, option)
        pixels = renderer.render()
    return (
        Image.fromarray(pixels)
        .resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS)
        .quantize(COLORS, dither=Image.Dither.NONE)
    )


def main() -> None:
    for name, view in VIEWS.items():
        file = ROOT / "docs" / f"mechanism-{name.replace('_', '-')}.png"
        picture(name, view).save(file, optimize=True)
        print(f"{file.name}: {file.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
