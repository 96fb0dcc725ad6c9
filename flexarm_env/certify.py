"""Certify the registered environments: `python -m flexarm_env.certify [ARM ...]`.

Each arm is certified once, with the steps its environments take, on motions of their kind: all
joints bang-bang at full torque for one period of the first joint-free mode, then coasting, and
random torques held for a control step each.
"""

import argparse
import json

from dynamics.arm_file import load_arm
from dynamics.certificate import Certificate, certify
from flexarm_env import SCENES
from flexarm_env.certificates import STORE, scene, stored
from flexarm_env.physics import integration

ACCURACY, LONG_ACCURACY = 1e-4, 1e-3  # of the reach; for more than two links, to end in minutes


def measure(name: str, control_dt: float) -> Certificate:
    """The certificate of a preset at its environments' step."""
    arm = load_arm(name)
    integrator, substeps = integration(arm, control_dt)
    accuracy = (ACCURACY if arm.n_joint <= 2 else LONG_ACCURACY) * arm.reach
    return certify(arm, scene(arm, control_dt), integrator, control_dt / substeps, accuracy)


def main() -> None:
    """Measure the default arms, or those named, and keep what was found."""
    steps = {arm: control_dt for arm, control_dt, _ in SCENES.values()}
    parser = argparse.ArgumentParser(description="Certify the environments' arms.")
    parser.add_argument("arms", nargs="*", metavar="ARM", help=f"of {sorted(steps)}; all")
    names = parser.parse_args().arms or list(steps)
    unknown = sorted(set(names) - set(steps))
    if unknown:
        parser.error(f"unknown arms {unknown}; known: {sorted(steps)}")
    entries = dict(stored())
    for name in names:
        certificate = measure(name, steps[name]).to_dict()
        entries[name] = {"control_dt": steps[name], "certificate": certificate}
        print(f"{name}: {json.dumps(certificate, indent=2)}")
        STORE.write_text(json.dumps(entries, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
