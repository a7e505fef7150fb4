"""A short run of two star heads and a gyro, as tables, with the truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray
from geoposition.sensors.kinematics import accumulated

ARCSEC = np.pi / 648000.0
SIGMA_STAR = 5.0 * ARCSEC
SIGMA_V = 2e-7
SIGMA_U = 1e-10
BIAS = np.array([3.0, -2.0, 1.0]) * 1e-6
R_body_b = Rotation.from_euler("XYZ", [0.3, -1.1, 0.4])


@dataclass(frozen=True)
class Scene:
    """Files of the run; the true attitude (n,) is that of the gyro epochs."""

    star: Path
    gyro: Path
    mounting: Path
    times_s: FloatArray
    R_inertial_body: Rotation


def write(folder: Path, span_s: float = 200.0, seed: int = 5) -> Scene:
    """Heads `a` (the body's axes) and `b` at 2 Hz, gyro increments at 10 Hz."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, span_s + 0.05, 0.1)
    middle = 0.5 * (times[1:] + times[:-1])
    rate = 1e-3 * np.stack(
        [np.sin(0.05 * middle), 1.0 + 0.2 * np.sin(0.02 * middle), np.cos(0.03 * middle)], axis=1
    )
    turn = 0.1 * rate
    quat = accumulated(Rotation.from_euler("ZYX", [0.5, 0.2, -0.9]).as_quat(), turn)
    truth = Rotation.from_quat(quat)
    noise = SIGMA_V * np.sqrt(0.1) * rng.standard_normal(turn.shape)
    measured = np.concatenate([[[0.0] * 3], turn + 0.1 * BIAS + noise])
    np.savetxt(
        folder / "gyro.csv", np.column_stack([times, measured]), delimiter=",",
        header="t_s,d_x,d_y,d_z", comments="", fmt="%.17g",
    )  # fmt: skip
    rows = ["t_s,sensor,q_x,q_y,q_z,q_w,sigma_cross_rad,sigma_bore_rad"]
    for k in range(0, len(times), 5):
        for name, mounted in (("a", Rotation.identity()), ("b", R_body_b)):
            error = Rotation.from_rotvec(SIGMA_STAR * rng.standard_normal(3))
            q = (truth[k] * mounted * error).as_quat()
            cells = [repr(float(times[k])), name, *(repr(float(c)) for c in q)]
            rows.append(",".join([*cells, f"{SIGMA_STAR:.6g}", f"{SIGMA_STAR:.6g}"]))
    (folder / "star.csv").write_text("\n".join(rows) + "\n")
    matrix = R_body_b.as_matrix().tolist()
    (folder / "mounting.toml").write_text(f"[b]\nmatrix = {matrix}\n")
    return Scene(folder / "star.csv", folder / "gyro.csv", folder / "mounting.toml", times, truth)
