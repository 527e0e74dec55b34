"""The swinging load of a crane, in MuJoCo: many rollouts in one call of `mujoco.rollout`."""

import mujoco
import numpy as np
from mujoco import rollout

import perfbound as pb

MODEL = mujoco.MjModel.from_xml_string("""
<mujoco>
  <option timestep="0.02" integrator="implicitfast"/>
  <worldbody>
    <body pos="0 0 10">
      <joint name="rail" type="slide" axis="1 0 0"/>
      <geom type="box" size="0.5 0.3 0.1" mass="500"/>
      <body>
        <joint name="rope" axis="0 -1 0" damping="200"/>
        <geom type="capsule" fromto="0 0 -7 0 0 -8" size="0.4" mass="1000"/>
      </body>
    </body>
  </worldbody>
  <actuator><velocity joint="rail" kv="20000"/></actuator>
</mujoco>""")
DATA = mujoco.MjData(MODEL)
INPUTS = mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_QFRC_APPLIED


@pb.system(
    parameters={"angle": pb.Parameter(-0.2, 0.2, unit="rad"), "rate": pb.Parameter(-0.2, 0.2, unit="rad/s")},
    columns={"position": "m", "angle": "rad", "speed": "m/s", "rate": "rad/s"},
    step=0.02,
    versions={"mujoco": mujoco.__version__},
    vectorised=True,
)
def swing(angle, rate, *, seeds, horizon, gusts=3000.0):
    """Carry a load of a ton over 8 m in 10 s, from a first swing, while gusts push it."""
    t = np.arange(0.02, horizon + 0.01, 0.02)
    start = np.zeros((len(angle), 5))  # time, then the columns
    start[:, 2], start[:, 4] = angle, rate
    inputs = np.zeros((len(angle), len(t), 3))
    inputs[:, :, 0] = np.interp(t, [0, 5, 10], [0, 1.6, 0])  # the speed of the trolley, m/s
    inputs[:, :, 2] = gusts * pb.normal(seeds, len(t))  # N m on the rope
    states, _ = rollout.rollout(MODEL, DATA, start, inputs, control_spec=int(INPUTS))
    return np.concatenate([start[:, np.newaxis], states], axis=1)[:, :, 1:]
