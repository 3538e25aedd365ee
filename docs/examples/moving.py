"""The moving picture of the README: a docking on the rig, with the force that the sensor reads and
the motion of the two spacecraft.

    MUJOCO_GL=egl python docs/examples/moving.py        # or MUJOCO_GL=glfw on a desktop, osmesa
    without a screen

Writes docs/docking.gif.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib
import mujoco
import numpy as np
from matplotlib import pyplot as plt
from PIL import Image

import hiltestbed
from hiltestbed.viewer.rig import RigScene

ROOT = Path(__file__).resolve().parents[2]
FRAMES_PER_SECOND = 12
WIDTH, HEIGHT = 640, 330  # [pixels]
RIG = 300  # [pixels] width of the rig's picture
SMOOTH = 2  # pixels that are averaged along each side
COLORS = 96  # of the palette
SKY = (0.96, 0.97, 0.98)
INK, MEASURED, FAINT = "#1f2a37", "#c0392b", "#c9d1da"


def rig_frames(run: hiltestbed.Run, rows: np.ndarray) -> list[Image.Image]:
    """The rig at the rows of the run's trace."""
    scene, trace = RigScene(run.scenario), run.trace
    assert trace is not None
    poses = {
        name: np.stack(
            [trace[f"{name}.{c}"] for c in ("px", "py", "pz", "qx", "qy", "qz", "qw")], axis=1
        )
        for name in ("pose_cmd", "pose_act")
    }
    joints = scene._joints(
        poses["pose_act"][rows],
        scene.port_poses(run.scenario, rows, poses["pose_cmd"], poses["pose_act"][rows]),
    )
    model, data = scene.model, scene.data
    model.vis.global_.offwidth, model.vis.global_.offheight = RIG * SMOOTH, HEIGHT * SMOOTH
    model.vis.headlight.ambient[:], model.vis.headlight.diffuse[:] = 0.45, 0.5
    camera, option = mujoco.MjvCamera(), mujoco.MjvOption()
    camera.lookat[:], camera.distance, camera.azimuth, camera.elevation = (
        (0.0, 0.0, -0.35),
        2.9,
        120.0,
        -6.0,
    )
    option.geomgroup[:], option.sitegroup[:] = (1, 1, 1, 0, 0, 0), 0
    out = []
    with mujoco.Renderer(model, HEIGHT * SMOOTH, RIG * SMOOTH) as renderer:
        for q in joints:
            data.qpos[:] = q
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera, option)
            pixels = renderer.render()
            pixels[(pixels == 0).all(axis=2)] = np.round(255 * np.array(SKY))
            out.append(Image.fromarray(pixels).resize((RIG, HEIGHT), Image.Resampling.LANCZOS))
    return out


def plot_frames(run: hiltestbed.Run, rows: np.ndarray) -> list[Image.Image]:
    """The signals up to each of the rows."""
    trace = run.trace
    assert trace is not None
    t, force, depth = trace["t"], trace["wrench_meas.fz"], 1e3 * trace["pose_act.pz"]
    figure, axes = plt.subplots(
        2,
        1,
        figsize=((WIDTH - RIG) / 80, HEIGHT / 80),
        dpi=80 * SMOOTH,
        sharex=True,
        layout="constrained",
    )
    figure.set_facecolor(SKY)
    lines = []
    for ax, values, label in zip(
        axes, (force, depth), ("force on the sensor [N]", "insertion [mm]"), strict=True
    ):
        ax.plot(t, values, color=FAINT, lw=1)
        lines.append(ax.plot([], [], color=MEASURED if values is force else INK, lw=1.4)[0])
        ax.set_title(label, fontsize=9, loc="left", color=INK)
        ax.tick_params(labelsize=8, colors=INK)
        ax.set_facecolor("white")
    axes[1].set_xlabel("time [s]", fontsize=9, color=INK)
    out = []
    for row in rows:
        for line, values in zip(lines, (force, depth), strict=True):
            line.set_data(t[: row + 1], values[: row + 1])
        figure.canvas.draw()
        picture = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3])  # type: ignore[attr-defined]
        out.append(picture.resize((WIDTH - RIG, HEIGHT), Image.Resampling.LANCZOS))
    plt.close(figure)
    return out


def main() -> None:
    matplotlib.use("Agg")
    run = hiltestbed.run(hiltestbed.load_scenario("09-docking"))
    assert run.trace is not None
    rows = np.arange(0, len(run.trace["t"]), round(run.scenario.rate / FRAMES_PER_SECOND))
    frames = []
    for rig, plot in zip(rig_frames(run, rows), plot_frames(run, rows), strict=True):
        frame = Image.new("RGB", (WIDTH, HEIGHT))
        frame.paste(rig, (0, 0))
        frame.paste(plot, (RIG, 0))
        frames.append(frame)
    palette = frames[len(frames) // 2].quantize(COLORS)
    file = ROOT / "docs" / "docking.gif"
    first, *rest = [f.quantize(palette=palette, dither=Image.Dither.NONE) for f in frames]
    first.save(
        file,
        save_all=True,
        append_images=rest,
        duration=1000 // FRAMES_PER_SECOND,
        loop=0,
        optimize=True,
    )
    print(f"{file.name}: {file.stat().st_size / 1e3:.0f} kB, {len(frames)} frames")


if __name__ == "__main__":
    main()
