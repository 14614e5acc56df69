"""Records of an oscillator that this project's integrator did not make, and the configured plants."""

import numpy as np
import pandas as pd
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from scipy.integrate import solve_ivp

from stages.science.plant.machines.second_order import Oscillator
from tests.science.plant.machines import CONF

HERTZ, RATE_HZ, LEAD_S = 68.0, 610.3515625, 0.5
NOISE_V, WANDER_V = 0.0005, 0.0005
OMEGA = 2 * np.pi * HERTZ


def configured(name):
    """The oscillator that `plant=...` describes."""
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return Oscillator(**OmegaConf.to_container(compose(overrides=[f"+plant={name}"]))["plant"])


def shake(generator, force, records=12, samples=1000):
    """Records of band-limited random motion; `force` (x, w) opposes it beside spring and damper, in spring units.

    Returns signals and blocks as the workflow reads them.
    """
    instants = np.arange(samples) / RATE_HZ
    lines = np.arange(2, 160) * 1.2
    phase = generator.uniform(0, 2 * np.pi, (len(lines), records))

    def drive(now):
        return 0.022 * np.sqrt(2 / len(lines)) * np.sin(2 * np.pi * lines[:, None] * now + phase).sum(axis=0)

    def rates(now, state):
        x, w = state.reshape(2, records)
        return np.concatenate([OMEGA * w, OMEGA * (drive(now) - x - 0.1 * w - force(x, w))])

    solved = solve_ivp(rates, (0, instants[-1]), np.zeros(2 * records), t_eval=instants, rtol=1e-6, atol=1e-8)
    motion = solved.y[:records].T + NOISE_V * generator.standard_normal((samples, records))
    motion += WANDER_V * np.sin(2 * np.pi * 0.4 * instants[:, None] + generator.uniform(0, 6, records))
    driven = np.array([drive(now) for now in instants])
    frames = [
        pd.DataFrame(
            {
                "record": f"record {k}",
                "time_s": instants,
                "drive_v": driven[:, k],
                "response_v": motion[:, k],
            }
        )
        for k in range(records)
    ]
    signals = pd.concat(frames).melt(["record", "time_s"], var_name="signal", value_name="value")
    first = round(LEAD_S * RATE_HZ)
    blocks = pd.DataFrame(
        {"record": [f"record {k}" for k in range(records)], "start_s": first / RATE_HZ, "samples": samples - first}
    )
    return signals, blocks
