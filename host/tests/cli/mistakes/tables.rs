//! Mistakes in tables of poses.

use super::{Mistake, TABLE};

fn of_table(what: &'static str, content: impl Into<Vec<u8>>, parts: &'static [&'static str]) -> Mistake {
    Mistake {
        what,
        file: ("bad.csv", content.into()),
        arguments: TABLE,
        parts,
    }
}
/// The mistakes; `good` is a table that is read.
pub(super) fn mistakes(good: &str) -> Vec<Mistake> {
    let edit = |from: &str, to: &str| {
        assert!(good.contains(from), "{from}");
        good.replacen(from, to, 1)
    };
    let first = good.lines().nth(1).expect("a row");
    let cell = first.split(',').next().expect("a cell");
    let row = |to: &str| good.replacen(first, to, 1);
    let column = |k: usize, f: &dyn Fn(f64) -> String| {
        let lines = good.lines().enumerate().map(|(n, line)| {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            if n > 0 {
                cells[k] = f(cells[k].parse().expect("a number"));
            }
            cells.join(",")
        });
        lines.collect::<Vec<_>>().join("\n")
    };
    let all = |name: &str, columns: std::ops::Range<usize>, scale: f64| {
        let lines = good.lines().enumerate().map(|(n, line)| {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            for cell in &mut cells[columns.clone()] {
                *cell = match n {
                    0 => cell.replace(name, ""),
                    _ => (cell.parse::<f64>().expect("a number") * scale).to_string(),
                };
            }
            cells.join(",")
        });
        lines.collect::<Vec<_>>().join("\n")
    };
    let utf16: Vec<u8> = good.encode_utf16().flat_map(u16::to_le_bytes).collect();
    let mut binary = good.as_bytes().to_vec();
    binary[good.len() / 2] = 0xff;
    vec![
        of_table("an empty file", "", &["no header line", "q1,q2"]),
        of_table(
            "a header alone",
            good.lines().next().expect("a header"),
            &["no rows", "one row per pose"],
        ),
        of_table(
            "no header",
            good.split_once('\n').expect("lines").1,
            &["holds numbers, not names", "q1..q6"],
        ),
        of_table(
            "a misspelt column",
            edit("x_mm", "x_nm"),
            &["\"x_nm\" is not known", "did you mean \"x_mm\"?", "--ignore-columns"],
        ),
        of_table(
            "a column without its unit",
            edit("x_mm,y_mm,z_mm", "x,y,z"),
            &["\"x\", \"y\", \"z\" are not known", "no unit", "x_mm or x_m"],
        ),
        of_table("a column twice", edit("q2", "Q1"), &["\"q1\" and \"Q1\" say the same"]),
        of_table("a joint is missing", edit("q3", "tau1"), &["q3 is missing", "6 joints"]),
        of_table(
            "a joint too many",
            edit("x_mm,y_mm,z_mm", "q7,sphere,place"),
            &["q7", "6 joints"],
        ),
        of_table("an axis is missing", edit("z_mm", "sphere"), &["z_mm is missing"]),
        of_table(
            "nothing is measured",
            edit("x_mm,y_mm,z_mm", "tau1,tau2,tau3"),
            &["tau4 is missing"],
        ),
        of_table(
            "a cell is text",
            edit(cell, "home"),
            &["row 1 (line 2)", "\"home\"", "write a number"],
        ),
        of_table("infinite", edit(cell, "-inf"), &["\"-inf\"", "finite"]),
        of_table("a formula that failed", edit(cell, "#DIV/0!"), &["#DIV/0!", "formula"]),
        of_table(
            "a thousands separator",
            edit(cell, "\"1,234\""),
            &["\"1,234\"", "decimal point"],
        ),
        of_table(
            "decimal commas and points mixed",
            row(&first.replace(',', ";").replacen('.', ",", 1))
                .replace("q1,q2,q3,q4,q5,q6,x_mm,y_mm,z_mm", "q1;q2;q3;q4;q5;q6;x_mm;y_mm;z_mm"),
            &["row 1 (line 2)", "mixed"],
        ),
        of_table(
            "a row too short",
            row(&first[..first.rfind(',').expect("cells")]),
            &["row 1 has 8 cells, the header has 9"],
        ),
        of_table(
            "a row too long",
            row(&format!("{first},7")),
            &["row 1 (line 2)", "\"7\"", "the header has 9 columns"],
        ),
        of_table(
            "a quote left open",
            edit(cell, &format!("\"{cell}")),
            &["line 2", "quote", "partner"],
        ),
        of_table("degrees as radians", all("_deg", 0..6, 57.3), &["column q", "_deg"]),
        of_table(
            "radians as degrees",
            all("", 0..6, 1.0).replacen("q1,q2,q3,q4,q5,q6", "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg", 1),
            &["no angle of the table is beyond", "radians"],
        ),
        of_table(
            "metres as millimetres",
            all("", 6..9, 1e-3),
            &["no coordinate of the table is beyond", "x_m"],
        ),
        of_table(
            "metres as millimetres, far from the tracker",
            column(6, &|x| (3000.0 + x * 1e-3).to_string())
                .lines()
                .map(std::borrow::ToOwned::to_owned)
                .enumerate()
                .map(|(n, l)| {
                    let mut c: Vec<String> = l.split(',').map(str::to_owned).collect();
                    if n > 0 {
                        for cell in &mut c[7..9] {
                            *cell = (cell.parse::<f64>().expect("a number") * 1e-3).to_string();
                        }
                    }
                    c.join(",")
                })
                .collect::<Vec<_>>()
                .join("\n"),
            &["spread of the measured points", "are metres"],
        ),
        of_table(
            "a point in kilometres",
            edit(&format!(",{}", first.rsplit(',').next().expect("z")), ",512345678"),
            &["z_mm", "more than 100 m", "unit"],
        ),
        of_table(
            "an unknown set",
            row(first)
                .replacen("z_mm", "z_mm,set", 1)
                .replacen(first, &format!("{first},test"), 1),
            &["calibrate or validate"],
        ),
        of_table(
            "a sphere by name",
            "q1,q2,q3,q4,q5,q6,sphere\n0,0,0,0,0,0,front\n",
            &["column sphere is \"front\"", "integer id"],
        ),
        of_table(
            "a placement per row",
            "q1,q2,q3,q4,q5,q6,sphere,place\n".to_owned()
                + &(0..300)
                    .map(|k| format!("0,0,0,0,0,0.{k},1,p{k}\n"))
                    .collect::<String>(),
            &[
                "300 values in the column place",
                "at most 200",
                "--ignore-columns place",
            ],
        ),
        of_table(
            "a second target that one row saw",
            "q1,q2,q3,q4,q5,q6,x1_mm,y1_mm,z1_mm,x2_mm,y2_mm,z2_mm\n".to_owned()
                + "0,0,0,0,0,0.9,100,2,3,1,2,30\n"
                + &(0..5)
                    .map(|k| format!("0,0,0,0,0,0.{k},10{k},2,3,,,\n"))
                    .collect::<String>(),
            &["target 2 is in 1 rows", "at least 3", "--ignore-columns"],
        ),
        of_table(
            "several targets beside spheres",
            "q1,q2,q3,q4,q5,q6,x1_mm,y1_mm,z1_mm,sphere\n".to_owned() + &"0,0,0,0,0,0,100,2,3,\n".repeat(5),
            &["a column sphere", "a table of their own"],
        ),
        of_table(
            "a quaternion that is none",
            "q1,q2,q3,q4,q5,q6,x_mm,y_mm,z_mm,qw,qx,qy,qz\n0,0,0,0,0,0,1,2,3,1,1,0,0\n",
            &["row 1", "length 1.4142", "length 1"],
        ),
        of_table(
            "a spreadsheet's own file",
            b"PK\x03\x04xl/worksheets".to_vec(),
            &["spreadsheet", "CSV UTF-8"],
        ),
        of_table(
            "a compressed file",
            b"\x1f\x8b\x08rest".to_vec(),
            &["compressed", "unpack"],
        ),
        of_table("UTF-16 without its mark", utf16, &["UTF-16", "UTF-8"]),
        of_table("bytes that are no text", binary, &["is not UTF-8", "line"]),
        of_table(
            "one endless line",
            "7".repeat(100_000),
            &["line 1", "longer than 65536 bytes"],
        ),
        of_table("escape sequences", edit("x_mm", "\u{1b}[2Jx_mm"), &["\\u001b[2jx_mm"]),
    ]
}
