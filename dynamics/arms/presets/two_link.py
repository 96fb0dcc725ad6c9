"""De Luca and Siciliano's planar two-link arm with a geared motor in its elbow; horizontal.

The published arm (preset deluca-siciliano) gives its elbow a mass but no inertia on the side of
the first link. With many modes the elbow's torque then meets almost no inertia there, so feedback
that is held over a control step becomes unstable: an artefact that no motor has. Here the elbow
turns a rotor of 5e-6 kg m^2 through a gear of 100. Frequencies with locked joints are unchanged.

Both links bend to fourth order. Link 1 has both shapes of a beam without mass, link 2 that under a
tip force: with these the tip stays within a thousandth of the reach in whole episodes at full
torque.
"""

from dataclasses import replace

from dynamics.arms.presets.deluca_siciliano import ARM as PUBLISHED
from dynamics.arms.presets.deluca_siciliano import CHECKS
from dynamics.description.mode_shapes import Mode

__all__ = ["ARM", "CHECKS"]

_ROTOR = 5e-6  # [kg m^2] chosen: a frameless motor of 50 mm
_GEAR = 100.0  # [-] chosen: a strain wave gear
_MODES = tuple(Mode(kind="hierarchical", index=k, direction="y") for k in (1, 2))
_SHOULDER, _ELBOW = PUBLISHED.links

ARM = replace(
    PUBLISHED,
    name="two-link",
    description=(
        "Two soft links in a horizontal plane with a payload and a geared elbow, after De Luca "
        "and Siciliano, 'Closed-form dynamic model of planar multilink lightweight robots', IEEE "
        "Trans. SMC 21(4), 1991."
    ),
    links=(
        replace(_SHOULDER, modes=_MODES),
        replace(_ELBOW, joint=replace(_ELBOW.joint, rotor_inertia=_ROTOR * _GEAR**2)),
    ),
)
