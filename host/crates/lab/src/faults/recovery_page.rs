//! Checks that `docs/recovery.md` agrees with the code.

// Fails if the page differs from what the code does. `SPHERECAL_BLESS=1` writes the tables.
#[test]
fn the_page_is_what_the_code_does() {
    use spherecal_campaign::recovery::{HANDSHAKE_S, LOST_S, table};

    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../docs/recovery.md");
    let text = std::fs::read_to_string(path).expect("the page");
    let put = |text: &str, name: &str, table: &str| {
        let (begin, end) = (format!("<!-- {name} -->\n"), format!("<!-- end of {name} -->"));
        let (before, rest) = text.split_once(&begin).expect("a beginning");
        let (_, after) = rest.split_once(&end).expect("an end");
        format!("{before}{begin}{table}{end}{after}")
    };
    let whole = put(&text, "faults", &table());
    let whole = put(&whole, "injected faults", &spherecal_sim::inject::table());
    if std::env::var_os("SPHERECAL_BLESS").is_some() {
        std::fs::write(path, &whole).expect("the page can be written");
        return;
    }
    assert_eq!(
        text, whole,
        "docs/recovery.md differs from the code: SPHERECAL_BLESS=1 rewrites its tables"
    );
    for value in [format!("{LOST_S} s"), format!("{HANDSHAKE_S} s")] {
        assert!(text.contains(&value), "{value}");
    }
}
