"""The contact definition of a domain's scene, read off the compiled MuJoCo model."""

from __future__ import annotations

import mujoco

from np_description.contact.model import ContactModel
from np_description.domains import Task
from np_description.scene import OBJECT, load_model


def contact_definition(domain: Task, contact: ContactModel | None = None) -> dict[str, object]:
    """Cone, impratio, timestep s of the scene with the domain's own object, as it is built by default, and by partner (surroundings, arm, fingers,
    object) the friction, solref, solimp and further parameters of its geoms, each parameter once for all geoms that share it. contact: default the domain's.
    """
    model = load_model(domain.as_rigid_box, contact=contact)
    partners: dict[str, dict[str, list]] = {}
    for geom in range(model.ngeom):
        if not (model.geom_contype[geom] or model.geom_conaffinity[geom]):
            continue
        partner = partners.setdefault(_partner(model.geom(geom).name), {})
        for name in ("friction", "solref", "solimp", "condim", "margin", "gap", "priority", "solmix"):
            value = getattr(model, f"geom_{name}")[geom].tolist()
            if value not in partner.setdefault(name, []):
                partner[name].append(value)
    return {
        "cone": mujoco.mjtCone(model.opt.cone).name.removeprefix("mjCONE_").lower(),
        "impratio": float(model.opt.impratio),
        "timestep": float(model.opt.timestep),
        **partners,
    }


def _partner(geom: str) -> str:
    if geom == OBJECT:
        return "object"
    if geom.startswith("panda_finger"):
        return "fingers"
    return "arm" if geom.startswith("panda_") else "surroundings"
