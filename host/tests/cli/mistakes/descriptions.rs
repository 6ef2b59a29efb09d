//! Mistakes in plates and robots, and in what the command line says of the files.

use spherecal::model::robots;

use super::Mistake;

const PLATE: &[&str] = &["--robot", "ur5e", "--data", "contacts.csv", "--plate", "bad.toml"];
const ROBOT_TOML: &[&str] = &["--robot", "bad.toml", "--data", "good.csv"];
const ROBOT_URDF: &[&str] = &["--robot", "bad.urdf", "--data", "good.csv"];
const ROBOT_YAML: &[&str] = &["--robot", "bad.yaml", "--data", "good.csv"];
fn with(
    arguments: &'static [&'static str],
    what: &'static str,
    file: &'static str,
    content: impl Into<Vec<u8>>,
    parts: &'static [&'static str],
) -> Mistake {
    Mistake {
        what,
        file: (file, content.into()),
        arguments,
        parts,
    }
}
/// The mistakes.
pub(super) fn mistakes() -> Vec<Mistake> {
    let sphere =
        |id: u32, x: &str, more: &str| format!("[[sphere]]\nid = {id}\nx_mm = {x}\ny_mm = 0\nz_mm = 0\n{more}\n");
    let toml = robots::toml_file::write(&robots::load("ur5e").expect("built in"), &[]);
    let model = robots::load("ur5e").expect("built in");
    let yaml = robots::write_kinematics_yaml(&model, &model.rows(), &[]);
    let urdf = robots::write_urdf(&model, &model.rows(), &[]);
    let attributes: String = (0..100_000).map(|k| format!(" a{k}=\"\"")).collect();
    vec![
        with(
            &["--robot", "ur5e", "--data", "good.csv", "--joint-columns", "a,b"],
            "too few joint columns",
            "x",
            "",
            &["--joint-columns is 2 names", "6 joints"],
        ),
        with(
            &["--robot", "ur5e", "--data", "good.csv", "--method", "map"],
            "the old name of a method",
            "x",
            "",
            &["map", "give `full`"],
        ),
        with(
            &["--robot", "ur5e", "--data", "good.csv", "--method", "nelder-mead"],
            "a method that the lab has now",
            "x",
            "",
            &["nelder-mead", "`spherecal-lab reproduce`"],
        ),
        with(
            &["--robot", "ur5e", "--data", "contacts.csv"],
            "contacts without a plate",
            "x",
            "",
            &["--plate", "no scale", "--plate paper"],
        ),
        with(
            &["--robot", "ur5e", "--data", "good.csv", "--holdout", "shift"],
            "an unknown hold-out",
            "x",
            "",
            &["column \"shift\"", "not in the table"],
        ),
        with(
            &["--robot", "ur5e", "--data", "good.csv", "--tool-mm", "1,2"],
            "half a tool",
            "x",
            "",
            &["--tool-mm is \"1,2\"", "three numbers"],
        ),
        with(
            &["--robot", "ur5e", "--data", "none.csv"],
            "no such table",
            "x",
            "",
            &["none.csv: there is no such file"],
        ),
        with(
            &["--robot", "ur5e", "--data", "."],
            "a directory",
            "x",
            "",
            &["is a folder without a file in MCAP or SQLite"],
        ),
        with(
            &["--robot", "ur5e", "--data", "/dev/zero"],
            "a device as a table",
            "x",
            "",
            &["/dev/zero: is a device"],
        ),
        with(
            &["--robot", "link.toml", "--data", "good.csv"],
            "a link to a device as a robot",
            "x",
            "",
            &["link.toml: is a device"],
        ),
        with(
            &["--robot", "ur5x", "--data", "good.csv"],
            "an unknown robot",
            "x",
            "",
            &["\"ur5x\" is neither built in nor a file", "did you mean ur5e?", "iiwa7"],
        ),
        with(
            &["--robot", "good.csv", "--data", "good.csv"],
            "a table as a robot",
            "x",
            "",
            &["good.csv: its name does not say what it is"],
        ),
        with(
            &["--robot", "ur5e", "--data", "good.csv", "--config", "bad.toml"],
            "unknown options",
            "bad.toml",
            "nois = 1\n",
            &["bad.toml: line 1: `nois` is not known here"],
        ),
        with(
            PLATE,
            "a plate without spheres",
            "bad.toml",
            "name = \"mine\"\n",
            &["0 spheres", "[[sphere]]"],
        ),
        with(
            PLATE,
            "a sphere twice",
            "bad.toml",
            sphere(1, "0", "") + &sphere(1, "9", ""),
            &["sphere id is 1", "twice"],
        ),
        with(
            PLATE,
            "a negative uncertainty",
            "bad.toml",
            sphere(1, "0", "sigma_mm = -0.002"),
            &["sphere 1: sigma_mm is -0.002", "1 sigma"],
        ),
        with(
            PLATE,
            "no uncertainty",
            "bad.toml",
            sphere(1, "0", "sigma_mm = 0"),
            &["sphere 1: sigma_mm is 0", "above 0"],
        ),
        with(
            PLATE,
            "spheres in one place",
            "bad.toml",
            sphere(1, "100", "") + &sphere(2, "100", ""),
            &["spheres 1 and 2 is 0.0000 mm", "same place"],
        ),
        with(
            PLATE,
            "a plate in metres",
            "bad.toml",
            sphere(1, "0", "") + &sphere(2, "0.3", ""),
            &["spheres 1 and 2 is 0.3000 mm", "x_m"],
        ),
        with(
            PLATE,
            "a coordinate in quotes",
            "bad.toml",
            sphere(1, "\"0\"", ""),
            &["line 3: found the text \"0\", expected a number"],
        ),
        with(
            PLATE,
            "a coordinate without its unit",
            "bad.toml",
            sphere(1, "0", "").replace("x_mm", "x"),
            &["line 3: `x` is not known here", "`x_mm`"],
        ),
        with(
            PLATE,
            "broken TOML",
            "bad.toml",
            "[[sphere]\n",
            &["bad.toml: line 1", "[[sphere]]"],
        ),
        with(
            ROBOT_TOML,
            "a robot's field misspelt",
            "bad.toml",
            toml.replacen("alpha =", "alfa =", 1),
            &["`alfa` is not known here", "`alpha`"],
        ),
        with(
            ROBOT_TOML,
            "limits the wrong way round",
            "bad.toml",
            toml.replacen("min_rad = -6", "min_rad = 9", 1),
            &["bad.toml: joint 1: max_rad"],
        ),
        with(
            ROBOT_URDF,
            "broken XML",
            "bad.urdf",
            urdf.replacen("</joint>", "", 1),
            &["bad.urdf: line", "not well-formed XML"],
        ),
        with(
            ROBOT_URDF,
            "a URDF in millimetres",
            "bad.urdf",
            urdf.replace("0.1625", "162.5"),
            &["origin xyz", "162.5", "lengths are in m"],
        ),
        with(
            ROBOT_URDF,
            "an unexpanded xacro",
            "bad.urdf",
            urdf.replace("0.1625", "${d1}"),
            &["${d1}", "xacro"],
        ),
        with(
            ROBOT_URDF,
            "a URDF with a document type",
            "bad.urdf",
            format!(
                "<!DOCTYPE robot [<!ENTITY a \"b\">]>{}",
                urdf.split_once("?>").expect("a declaration").1
            ),
            &["<!DOCTYPE", "remove"],
        ),
        with(
            ROBOT_URDF,
            "a URDF of attributes",
            "bad.urdf",
            format!("<robot{attributes}/>"),
            &["more than 64 attributes"],
        ),
        with(
            ROBOT_YAML,
            "a joint origin without z",
            "bad.yaml",
            yaml.replacen("    z: 0.1625\n", "", 1),
            &["shoulder: z is \"\"", "all six numbers"],
        ),
        with(
            ROBOT_YAML,
            "a joint origin in text",
            "bad.yaml",
            yaml.replacen("z: 0.1625", "z: tall", 1),
            &["shoulder: z is \"tall\"", "finite number"],
        ),
    ]
}
