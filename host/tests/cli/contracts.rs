//! Pages as contracts: every sentence that promises something names the tests that hold it.
//!
//! `contracts/PAGE.txt` divides a page into passages. Its lines at the margin are the number of sentences of a passage and its
//! first words; the lines below them are the tests: file and function.

use std::path::Path;

use crate::docs::root;

/// Headings below which a page reports what was measured on a day.
const REPORTS: [&str; 2] = ["# Measured", "# What couplings show"];

/// The text of a page without its code, its reports and the tables that a test compares with the program, on one line.
fn text(page: &str) -> String {
    let (mut text, mut code, mut report, mut generated) = (String::new(), false, false, false);
    for line in std::fs::read_to_string(root().join(page)).expect("a page").lines() {
        code ^= line.starts_with("```");
        generated = if generated {
            !line.starts_with("<!-- end")
        } else {
            line.starts_with("<!--")
        };
        if line.starts_with('#') {
            report = REPORTS.iter().any(|heading| line.ends_with(heading));
        } else if !(code || report || generated || line.starts_with("```") || line.starts_with("<!--")) {
            text.push_str(line.trim());
            text.push(' ');
        }
    }
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// How many sentences, items and rows a passage has, roughly: one more or one less is seen.
fn sentences(passage: &str) -> usize {
    let ends = [". ", "; ", ": ", "| |"];
    ends.iter().map(|end| passage.matches(end).count()).sum::<usize>() + 1
}

/// Compares a page with its contract. Returns what does not agree.
fn broken(page: &str, contract: &str) -> Vec<String> {
    let text = text(page);
    let contract = std::fs::read_to_string(root().join("host/tests/cli/contracts").join(contract)).expect("a contract");
    let (mut broken, mut passages, mut tested) = (Vec::new(), Vec::new(), true);
    for line in contract.lines() {
        if let Some(test) = line.strip_prefix("    ") {
            tested = true;
            let (file, name) = test.split_once(' ').expect("a file and a function");
            let code = std::fs::read_to_string(root().join(file)).unwrap_or_default();
            if !code.contains(&format!("fn {name}(")) {
                broken.push(format!("there is no test {name} in {file}"));
            }
            continue;
        }
        let (count, words) = line.split_once(' ').expect("a number and words");
        if !std::mem::take(&mut tested) {
            broken.push(format!("the passage before \"{words}\" has no test"));
        }
        let from = passages.last().map_or(0, |(at, _, _)| at + 1);
        match text.get(from..).and_then(|rest| rest.find(words)) {
            Some(at) => passages.push((from + at, count.parse::<usize>().expect("a number"), words)),
            None => broken.push(format!("\"{words}\" is not there, or at another place")),
        }
    }
    if passages.first().is_none_or(|(at, _, _)| *at > 0) {
        broken.push("the page begins with another sentence".to_owned());
    }
    for (number, (at, count, words)) in passages.iter().enumerate() {
        let end = passages.get(number + 1).map_or(text.len(), |(next, _, _)| *next);
        let found = sentences(&text[*at..end]);
        if found != *count {
            broken.push(format!(
                "{found} sentences from \"{words}\" on, and its contract is of {count}: give each a test that holds it, or \
                 leave it out"
            ));
        }
    }
    broken
}

// Fails if a sentence comes to or goes from a page whose sentences are promises and nobody says which test holds it, or if
// such a test is no longer there.
#[test]
fn every_sentence_has_its_test() {
    for page in ["recovery", "services"] {
        let path = Path::new("docs").join(page).with_extension("md");
        let broken = broken(&path.display().to_string(), &format!("{page}.txt"));
        assert!(broken.is_empty(), "{}:\n{}", path.display(), broken.join("\n"));
    }
}

// Fails if a sentence that is added, a test that is gone, or words that have changed are not noticed.
#[test]
fn a_broken_contract_is_noticed() {
    assert_eq!(sentences("One promise. Another: this; and that."), 4);
    let of_other_page = broken("docs/services.md", "recovery.txt");
    assert!(of_other_page.len() > 20, "{of_other_page:?}");
}
