"""The iiwa 7 of tests/data/iiwa7.json as a MuJoCo model, for the oracle and the speed comparison.

    pip install mujoco        (4.0.0 made the data that lie in tests/data)

Nothing here is used by the product; the Rust plant and this model share only
the numbers of iiwa7.json and of the tool.
"""
import json
import math
import pathlib

DATA = pathlib.Path(__file__).resolve().parent.parent / "data"

# The tool of the product's default: 1.5 kg, TCP (50, 0, 100) mm, mass centre (25, 0, 50) mm.
TOOL = dict(mass=1.5, com=(0.025, 0.0, 0.050), inertia=(0.0012, 0.0022, 0.0022), tcp=(0.05, 0.0, 0.10))


def rows():
    """alpha, a, d (m, rad), mass, centre of mass and inertia about it (xx yy zz xy xz yz) of each joint."""
    data = json.loads((DATA / "iiwa7.json").read_text())
    kinematics = data["kinematics"]
    out = []
    for i, link in enumerate(data["links"]):
        inertia = [link["inertia_com"][k] for k in ("xx", "yy", "zz", "xy", "xz", "yz")]
        out.append(
            dict(
                alpha=kinematics["alpha"][i],
                a=kinematics["a"][i],
                d=kinematics["d"][i],
                mass=link["mass"],
                com=link["com"],
                inertia=inertia,
            )
        )
    return out


def reflected_rotors():
    """Rotor inertias at the link side, kg m2."""
    return json.loads((DATA / "iiwa7.json").read_text())["rotor"]["reflected"]


def quaternion_x(angle):
    return (math.cos(angle / 2), math.sin(angle / 2), 0.0, 0.0)


def numbers(values):
    return " ".join(repr(float(v)) for v in values)


def model(rows, timestep, integrator="RK4", coulomb=0.0, viscous=0.0, armature=None, seated=None, solver="", spring=None, rigid_friction=False):
    """MJCF text. `spring`: rest angles of weak joint springs that hold the arm, or None. `rows`: list of dicts alpha a d mass com inertia. `seated`: sphere centre in F0 or None."""
    armature = armature or [0.0] * len(rows)
    n = len(rows)
    body = ""
    close = ""
    # MuJoCo's friction is soft by default; this makes it Coulomb's law nearly.
    rigid = f'solreffriction="{2 * timestep} 1" solimpfriction="0.99999 0.99999 0.001 0.5 2"' if rigid_friction else ""
    for i, row in enumerate(rows):
        hold = f'stiffness="50" springref="{spring[i]!r}"' if spring is not None else ""
        a, alpha, d = row["a"], row["alpha"], row["d"]
        pos = (a, -math.sin(alpha) * d, math.cos(alpha) * d)
        body += f'<body name="l{i+1}" pos="{numbers(pos)}" quat="{numbers(quaternion_x(alpha))}">\n'
        body += (
            f'<joint name="j{i+1}" type="hinge" axis="0 0 1" damping="{viscous}" frictionloss="{coulomb}" '
            f'armature="{armature[i]}" {hold} {rigid}/>\n'
        )
        body += (
            f'<inertial pos="{numbers(row["com"])}" mass="{row["mass"]}" fullinertia="{numbers(row["inertia"])}"/>\n'
        )
        close += "</body>\n"
    body += f'<body name="tool"><inertial pos="{numbers(TOOL["com"])}" mass="{TOOL["mass"]}" diaginertia="{numbers(TOOL["inertia"])}"/>\n'
    body += f'<site name="tcp" pos="{numbers(TOOL["tcp"])}"/>\n'
    world = ""
    if seated is not None:
        # Three pads of a cube corner open towards +z, each a box whose face is tangent to the sphere.
        for k in range(3):
            phi = 2 * math.pi * k / 3
            u = (math.sqrt(2 / 3) * math.cos(phi), math.sqrt(2 / 3) * math.sin(phi), -math.sqrt(1 / 3))
            centre = [t + 0.0254 * x + 0.004 * x for t, x in zip(TOOL["tcp"], u)]
            body += (
                f'<geom type="box" size="0.008 0.008 0.004" pos="{numbers(centre)}" '
                f'zaxis="{numbers(u)}" mass="0" friction="0.15" solref="-1000000 -1000" solimp="0.99 0.99 0.001"/>\n'
            )
        world = (
            f'<geom name="sphere" type="sphere" size="0.0254" pos="{numbers(seated)}" friction="0.15" '
            'solref="-1000000 -1000" solimp="0.99 0.99 0.001"/>\n'
            '<geom name="plate" type="plane" size="1 1 0.1" pos="0 0 0.2"/>\n'
        )
    body += "</body>\n" + close
    actuators = "".join(f'<motor joint="j{i+1}"/>' for i in range(n))
    return f"""<mujoco><compiler angle="radian" balanceinertia="false" boundmass="0" boundinertia="0" inertiafromgeom="false"/>
<option timestep="{timestep!r}" integrator="{integrator}" gravity="0 0 -9.81" {solver}/>
<worldbody>{world}{body}</worldbody><actuator>{actuators}</actuator></mujoco>"""
