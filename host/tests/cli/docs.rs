//! The documentation is held to the program: every link leads somewhere, and
//! every `spherecal` command in it is one that the program takes.

use std::path::{Path, PathBuf};

use clap::Parser as _;
use pulldown_cmark::{CodeBlockKind, Event, Options, Parser, Tag, TagEnd};
use spherecal::cli::Cli;

pub(crate) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Pages for users and for developers, at the root and in the book.
pub(crate) fn pages() -> Vec<PathBuf> {
    let at_root = ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md"];
    let mut pages: Vec<_> = at_root.iter().map(|name| root().join(name)).collect();
    let mut folders = vec![root().join("docs")];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).expect("a folder of the book") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "md") {
                pages.push(path);
            }
        }
    }
    pages.sort();
    pages
}

/// What a page links to, and the code in it: blocks by line, and spans.
fn read(page: &Path) -> (Vec<String>, Vec<String>) {
    let text = std::fs::read_to_string(page).expect("a page");
    let (mut links, mut code, mut block) = (Vec::new(), Vec::new(), None);
    for event in Parser::new_ext(&text, Options::ENABLE_TABLES) {
        match event {
            Event::Start(Tag::Link { dest_url, .. } | Tag::Image { dest_url, .. }) => links.push(dest_url.to_string()),
            Event::Start(Tag::CodeBlock(CodeBlockKind::Fenced(kind))) if kind.starts_with("console") => {
                block = Some(String::new());
            }
            Event::Text(words) if block.is_some() => block.as_mut().expect("inside").push_str(&words),
            Event::End(TagEnd::CodeBlock) => {
                let lines = block.take().unwrap_or_default();
                code.extend(lines.lines().filter_map(|l| l.strip_prefix("$ ")).map(str::to_owned));
            }
            Event::Code(words) if words.starts_with("spherecal ") => code.push(words.to_string()),
            _ => {}
        }
    }
    (links, code)
}

/// The code blocks of a page whose language is `kind`: all that stands beside
/// it at the block's head, and the text.
pub(crate) fn blocks(page: &Path, kind: &str) -> Vec<(String, String)> {
    let of_kind = |(head, _): &(String, String)| head.split_whitespace().next() == Some(kind);
    pieces(page).into_iter().filter(of_kind).collect()
}

/// All fenced blocks of a page in their order: the block's head, and the text.
pub(crate) fn pieces(page: &Path) -> Vec<(String, String)> {
    let text = std::fs::read_to_string(page).expect("a page");
    let (mut blocks, mut block) = (Vec::new(), None);
    for event in Parser::new(&text) {
        match event {
            Event::Start(Tag::CodeBlock(CodeBlockKind::Fenced(head))) => {
                block = Some((head.to_string(), String::new()));
            }
            Event::Text(words) => {
                if let Some((_, text)) = &mut block {
                    text.push_str(&words);
                }
            }
            Event::End(TagEnd::CodeBlock) => blocks.extend(block.take()),
            _ => {}
        }
    }
    blocks
}

/// The name that a heading's anchor has in mdBook and on GitHub.
fn anchors(page: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(page).expect("a page");
    text.lines()
        .filter_map(|line| line.strip_prefix('#'))
        .map(|line| {
            let heading = line.trim_start_matches('#').trim().to_lowercase();
            heading
                .chars()
                .filter(|c| c.is_alphanumeric() || " -_".contains(*c))
                .map(|c| if c == ' ' { '-' } else { c })
                .collect()
        })
        .collect()
}

// Fails if a relative link or the anchor in it leads nowhere, or if a page of
// the folder is not in the table of contents.
#[test]
fn every_link_leads_somewhere() {
    let mut wrong = Vec::new();
    let mut checked = 0;
    for page in pages() {
        for link in read(&page).0 {
            if link.starts_with("http") || link.starts_with("mailto:") {
                continue;
            }
            let (file, anchor) = link.split_once('#').unwrap_or((&link, ""));
            let target = if file.is_empty() {
                page.clone()
            } else {
                page.parent().expect("a folder").join(file)
            };
            checked += 1;
            if !target.exists() || (!anchor.is_empty() && !anchors(&target).contains(&anchor.to_owned())) {
                wrong.push(format!("{}: {link}", page.display()));
            }
        }
    }
    assert!(checked >= 15, "{checked} links");
    assert!(wrong.is_empty(), "{wrong:#?}");
    let book = root().join("docs");
    let contents = read(&book.join("SUMMARY.md")).0;
    for name in pages().iter().filter_map(|page| page.strip_prefix(&book).ok()) {
        let name = name.display().to_string();
        assert!(
            name == "SUMMARY.md" || contents.contains(&name),
            "{name} is not in SUMMARY.md"
        );
    }
}

// Fails if the README grows beyond a page: 130 lines, or 40 numbers in text, tables and code.
#[test]
fn the_readme_is_a_page() {
    let page = std::fs::read_to_string(root().join("README.md")).expect("the page");
    assert!(page.lines().count() <= 130, "{} lines", page.lines().count());
    // A number is a run of digits, points and commas that is no part of a word.
    let numbers = page
        .split(|c: char| !(c.is_alphanumeric() || "_.,".contains(c)))
        .map(|word| word.trim_matches(['.', ',']))
        .filter(|word| word.starts_with(|c: char| c.is_ascii_digit()) && !word.contains(char::is_alphabetic))
        .count();
    assert!(numbers <= 40, "{numbers} numbers");
}

// Fails if a page shows a command, an option or a value that the program refuses.
#[test]
fn every_command_is_one_that_the_program_takes() {
    let mut wrong = Vec::new();
    let mut checked = 0;
    for page in pages() {
        for line in read(&page).1 {
            // Of a line of a shell: each part, without what it is piped to and its remarks.
            for part in line.split("&&").flat_map(|p| p.split('|')) {
                let part = part
                    .split(" #")
                    .next()
                    .unwrap_or_default()
                    .split('>')
                    .next()
                    .unwrap_or_default();
                let Some(words) = shlex::split(part) else {
                    wrong.push(format!("{}: {line}", page.display()));
                    continue;
                };
                if words.first().is_none_or(|w| w != "spherecal") {
                    continue;
                }
                checked += 1;
                let parsed = Cli::try_parse_from(&words);
                let shown = |e: &clap::Error| {
                    use clap::error::ErrorKind::{DisplayHelp, DisplayVersion};
                    matches!(e.kind(), DisplayHelp | DisplayVersion)
                };
                if let Err(error) = parsed
                    && !shown(&error)
                    // A command named without what it needs, in running text.
                    && !(error.kind() == clap::error::ErrorKind::MissingRequiredArgument && words.len() <= 2)
                {
                    wrong.push(format!("{}: {part}: {error}", page.display()));
                }
            }
        }
    }
    assert!(checked >= 40, "{checked} commands");
    assert!(wrong.is_empty(), "{wrong:#?}");
}
