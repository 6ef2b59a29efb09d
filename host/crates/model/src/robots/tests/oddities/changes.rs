//! Changes of a file's text.

/// A change of a file's text: its name, the change, what a refusal says; `None` where the file is read as before.
pub(super) type Change = (&'static str, fn(&str) -> String, Option<&'static str>);

/// Behind the start tag of the robot.
fn inside(text: &str, more: &str) -> String {
    text.replacen("<link", &format!("{more}<link"), 1)
}

pub(super) const CHANGES: [Change; 41] = [
    (
        "hyphens in comments",
        |t| inside(t, "<!-- -- Gelenk ä -- --><!-------><!-- a --->"),
        None,
    ),
    (
        "comments",
        |t| {
            format!(
                "<!-- <joint/> -->{}",
                inside(t, "<!-- <joint name=\"x\" type=\"revolute\"/> -->")
            )
        },
        None,
    ),
    (
        "a declaration",
        |t| format!("<?xml version=\"1.0\" encoding=\"utf-8\"?>\n{t}"),
        None,
    ),
    ("a byte order mark", |t| format!("\u{feff}{t}"), None),
    ("lines of Windows", |t| t.replace('\n', "\r\n"), None),
    ("no line ends", |t| t.replace('\n', ""), None),
    ("quotes", |t| t.replace('"', "'"), None),
    (
        "tabs in numbers",
        |t| t.replace("0.01 0.02 0.1", "\t0.01\t0.02 \n 0.1 "),
        None,
    ),
    (
        "a declared name space",
        |t| t.replacen("<robot", "<robot xmlns:xacro=\"http://www.ros.org/wiki/xacro\"", 1),
        None,
    ),
    (
        "leftovers of xacro",
        |t| inside(t, "<xacro:property name=\"pi\" value=\"3.14\"/>"),
        None,
    ),
    (
        "$(find) in a mesh",
        |t| {
            t.replacen("<link name=", "<link name=\"m\"><visual><geometry><mesh filename=\"$(find a)/b.stl\"/></geometry></visual></link><link name=", 1)
        },
        None,
    ),
    (
        "a number of xacro",
        |t| t.replacen("0.01 0.02 0.1", "0 0 ${d1}", 1),
        Some("xacro FILE.xacro > FILE.urdf"),
    ),
    (
        "a macro without robot",
        |t| {
            t.replace("link name", "xacro:arm name")
                .replace("<joint", "<xacro:joint")
                .replace("</joint", "</xacro:joint")
        },
        Some("xacro"),
    ),
    (
        "a document type",
        |t| format!("<!DOCTYPE robot>{t}"),
        Some("document type"),
    ),
    (
        "cut short",
        |t| t[..t.len() * 2 / 3].to_owned(),
        Some("not well-formed XML"),
    ),
    ("a stray &", |t| inside(t, "R&D"), Some("not well-formed XML")),
    ("empty", |_| String::new(), Some("a URDF starts with <robot")),
    ("blanks", |_| " \n".to_owned(), Some("a URDF starts with <robot")),
    ("SDF", |t| t.replace("robot", "sdf"), Some("the root element is <sdf>")),
    (
        "transmissions",
        |t| {
            inside(
                t,
                "<transmission name=\"t\"><joint name=\"x\"/><actuator name=\"m\"/></transmission>",
            )
        },
        None,
    ),
    (
        "ros2_control",
        |t| {
            inside(
                t,
                "<ros2_control name=\"c\" type=\"system\"><joint name=\"x\"><command_interface name=\"position\"/></joint></ros2_control>",
            )
        },
        None,
    ),
    (
        "gazebo",
        |t| {
            inside(
                t,
                "<gazebo reference=\"l\"><joint name=\"x\"/><link name=\"y\"/></gazebo>",
            )
        },
        None,
    ),
    (
        "materials",
        |t| inside(t, "<material name=\"m\"><color rgba=\"1 0 0 1\"/></material>"),
        None,
    ),
    (
        "an empty inertial",
        |t| t.replacen("\"/>", "\"><inertial/></link>", 1),
        None,
    ),
    (
        "a mass of zero",
        |t| t.replacen("\"/>", "\"><inertial><mass value=\"0\"/></inertial></link>", 1),
        None,
    ),
    (
        "an inertia without a mass",
        |t| {
            t.replacen(
                "\"/>",
                "\"><inertial><inertia ixx=\"1\" iyy=\"1\" izz=\"1\"/></inertial></link>",
                1,
            )
        },
        None,
    ),
    (
        "a mass that is no number",
        |t| t.replacen("\"/>", "\"><inertial><mass value=\"heavy\"/></inertial></link>", 1),
        Some("mass value is \"heavy\""),
    ),
    (
        "links that nothing names",
        |t| inside(t, "<link name=\"unused\"/>"),
        None,
    ),
    (
        "links that are not listed",
        |t| t.replacen("<link name=\"link3\"/>", "", 1),
        None,
    ),
    (
        "a link's name twice",
        |t| inside(t, "<link name=\"twice\"/><link name=\"twice\"/>"),
        Some("a link's name is \"twice\": stands twice"),
    ),
    ("no axis", |t| t.replacen("<axis xyz=\"0 0 1\"/>", "", 1), None),
    (
        "a long axis",
        |t| t.replace("<axis xyz=\"0 0 1\"/>", "<axis xyz=\"0 0 -2\"/>"),
        None,
    ),
    (
        "an axis without length",
        |t| t.replacen("<axis xyz=\"0 0 1\"/>", "<axis xyz=\"0 0 0\"/>", 1),
        Some("axis xyz is \"0 0 0\""),
    ),
    (
        "no origin",
        |t| t.replacen("<origin xyz=\"0.01 0.02 0.1\" rpy=\"0 0 0.1\"/>", "", 1),
        None,
    ),
    ("numbers of C", |t| t.replace("0.01 0.02 0.1", "+.01 2.e-2 1E-1"), None),
    (
        "commas in numbers",
        |t| t.replacen("0.01 0.02 0.1", "0.01, 0.02, 0.1", 1),
        Some("separated by spaces"),
    ),
    (
        "two numbers",
        |t| t.replacen("0.01 0.02 0.1", "0.01 0.02", 1),
        Some("three numbers"),
    ),
    (
        "a length in mm",
        |t| t.replacen("0.01 0.02 0.1", "10 20 1000", 1),
        Some("lengths are in m"),
    ),
    (
        "an angle in degrees",
        |t| t.replacen("0 0 0.1\"", "0 0 90\"", 1),
        Some("angles in rad"),
    ),
    (
        "infinite limits",
        |t| t.replace("<axis", "<limit lower=\"-inf\" upper=\"inf\" velocity=\"inf\"/><axis"),
        None,
    ),
    (
        "calibration, dynamics and safety",
        |t| {
            t.replace(
                "<axis",
                "<calibration rising=\"0\"/><dynamics damping=\"1\"/><safety_controller k_velocity=\"1\"/><axis",
            )
        },
        None,
    ),
];
