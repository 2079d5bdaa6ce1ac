//! No import cycles among the files of a crate. A module's own file and the files below it may use each other.

use super::{Source, none, sources};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// An import: its path, from the root or the current module, and its name in this module, or `*` for all names.
#[derive(Debug, PartialEq)]
struct Import {
    path: Vec<String>,
    alias: String,
}

/// A source file as a module of its crate.
#[derive(Debug, Default)]
struct Module {
    file: String,
    /// Path from the root, whose own path is empty.
    path: Vec<String>,
    /// Names defined at the top level of the file.
    items: BTreeSet<String>,
    /// Imports at the top level of the file.
    imports: Vec<Import>,
    /// All paths in the file, from the root.
    used: Vec<Vec<String>>,
    /// Modules that are compiled only for tests.
    tests: Vec<Vec<String>>,
}

/// The identifiers and punctuation of a source text, without comments and literals.
fn tokens(text: &str) -> Vec<String> {
    let text: Vec<char> = text.chars().collect();
    let at = |i: usize| text.get(i).copied().unwrap_or('\0');
    let is_word = |c: char| c.is_alphanumeric() || c == '_';
    let (mut found, mut i) = (Vec::new(), 0);
    while i < text.len() {
        let end = match (at(i), at(i + 1)) {
            ('/', '/') => (i..text.len()).find(|&j| at(j) == '\n').unwrap_or(text.len()),
            ('/', '*') => comment_end(&text, i),
            ('"', _) => string_end(&text, i, &mut found),
            ('r' | 'b' | 'c', _) if raw_string(&text, i).is_some() => raw_string(&text, i).unwrap(),
            // An escaped character, another character, or a lifetime.
            ('\'', '\\') => (i + 3..text.len()).find(|&j| at(j) == '\'').unwrap_or(text.len()) + 1,
            ('\'', _) if at(i + 2) == '\'' => i + 3,
            (':', ':') => {
                found.push("::".to_owned());
                i + 2
            }
            (c, _) if is_word(c) => {
                let end = (i..text.len()).find(|&j| !is_word(at(j))).unwrap_or(text.len());
                found.push(text[i..end].iter().collect());
                end
            }
            (c, _) => {
                if !c.is_whitespace() && c != '\'' {
                    found.push(c.to_string());
                }
                i + 1
            }
        };
        i = end;
    }
    found
}

/// End of a block comment, which may contain others.
fn comment_end(text: &[char], start: usize) -> usize {
    let (mut depth, mut i) = (0, start);
    while i + 1 < text.len() {
        match (text[i], text[i + 1]) {
            ('/', '*') => depth += 1,
            ('*', '/') => depth -= 1,
            _ => {
                i += 1;
                continue;
            }
        }
        i += 2;
        if depth == 0 {
            return i;
        }
    }
    text.len()
}

/// End of a string literal. A path in it, as in an attribute of serde, counts like one in the code.
fn string_end(text: &[char], start: usize, found: &mut Vec<String>) -> usize {
    let mut end = start + 1;
    while end < text.len() && text[end] != '"' {
        end += if text[end] == '\\' { 2 } else { 1 };
    }
    let content: String = text[start + 1..end.min(text.len())].iter().collect();
    if content.starts_with("crate::") {
        found.extend(tokens(&content));
    }
    end + 1
}

/// End of the raw string that starts here, if one does.
fn raw_string(text: &[char], start: usize) -> Option<usize> {
    let letters = text[start..].iter().take_while(|c| matches!(c, 'r' | 'b' | 'c')).count();
    let marks = text[start + letters..].iter().take_while(|&&c| c == '#').count();
    let open = start + letters + marks;
    if text.get(open) != Some(&'"') || !text[start..start + letters].contains(&'r') {
        return None;
    }
    let closes =
        |&i: &usize| text[i] == '"' && text[i + 1..].iter().take_while(|&&c| c == '#').count() >= marks;
    (open + 1..text.len()).find(closes).map(|end| end + 1 + marks)
}

/// Index of the token after the item that starts here.
fn item_end(tokens: &[String], start: usize) -> usize {
    let (mut depth, mut i) = (0_i32, start);
    let is_use = tokens[start..].iter().take_while(|token| *token != "{").any(|token| token == "use");
    while i < tokens.len() {
        match tokens[i].as_str() {
            "(" | "[" | "{" => depth += 1,
            ")" | "]" | "}" => depth -= 1,
            ";" if depth == 0 => return i + 1,
            _ => {}
        }
        if depth < 0 {
            return i;
        }
        i += 1;
        if depth == 0 && tokens[i - 1] == "}" && !is_use {
            return i;
        }
    }
    i
}

/// Removes items that are compiled only for tests; returns the names of modules among them that are files.
fn remove_tests(tokens: &mut Vec<String>) -> Vec<String> {
    let starts = |tokens: &[String], what: &[&str]| {
        tokens.len() >= what.len() && tokens.iter().zip(what).all(|(token, word)| token == word)
    };
    let mut modules = Vec::new();
    let mut i = 0;
    while i < tokens.len() {
        let rest = &tokens[i..];
        let inner = starts(rest, &["#", "!"]);
        let attribute = if inner { rest.get(2..) } else { rest.get(1..) }.unwrap_or_default();
        let for_tests = rest[0] == "#"
            && [&["[", "cfg", "(", "test", ")"][..], &["[", "cfg", "(", "all", "(", "test"]]
                .iter()
                .any(|cfg| starts(attribute, cfg));
        if !for_tests {
            i += 1;
        } else if inner {
            tokens.clear();
        } else {
            // The attribute, further attributes, the item.
            let mut item = i;
            while tokens.get(item).is_some_and(|token| token == "#") {
                let close = |j: &usize| {
                    let depth = |token: &String| i32::from(token == "[") - i32::from(token == "]");
                    tokens[item + 1..=*j].iter().map(depth).sum::<i32>() == 0
                };
                item = (item + 1..tokens.len()).find(close).unwrap_or(tokens.len() - 1) + 1;
            }
            let end = item_end(tokens, item);
            if let Some(at) = tokens[item..end].iter().position(|token| token == "mod")
                && tokens[item + at + 2] == ";"
            {
                modules.push(tokens[item + at + 1].clone());
            }
            tokens.drain(i..end);
        }
    }
    modules
}

/// Imports of the tree that starts at `*i`, after `use` or `::`; leaves `*i` at the token after it.
fn import_tree(tokens: &[String], i: &mut usize, prefix: &[String], found: &mut Vec<Import>) {
    let mut path = prefix.to_vec();
    while *i < tokens.len() {
        match tokens[*i].as_str() {
            "{" => {
                *i += 1;
                while tokens[*i] != "}" {
                    import_tree(tokens, i, &path, found);
                    *i += usize::from(tokens[*i] == ",");
                }
                *i += 1;
                return;
            }
            "*" => {
                *i += 1;
                found.push(Import { path, alias: "*".to_owned() });
                return;
            }
            name => {
                if name != "self" || path.is_empty() {
                    path.push(name.to_owned());
                }
                *i += 1;
            }
        }
        match tokens[*i].as_str() {
            "::" => *i += 1,
            // After the `::` that begins the path of another crate.
            _ if path == ["::"] => {}
            "as" => {
                found.push(Import { path, alias: tokens[*i + 1].clone() });
                *i += 2;
                return;
            }
            _ => {
                let alias = path.last().unwrap().clone();
                found.push(Import { path, alias });
                return;
            }
        }
    }
}

impl Module {
    fn new(file: &str, text: &str) -> Self {
        let mut path: Vec<_> = file.trim_end_matches(".rs").split('/').map(str::to_owned).collect();
        if matches!(path.last().map(String::as_str), Some("mod" | "lib" | "main")) {
            path.pop();
        }
        let mut tokens = tokens(text);
        let tests = remove_tests(&mut tokens);
        let below = |name: String| path.iter().cloned().chain([name]).collect();
        let tests = tests.into_iter().map(below).collect();
        let mut module = Self { file: file.to_owned(), path, tests, ..Self::default() };
        module.read(&tokens);
        module
    }

    /// Finds items, imports and paths.
    fn read(&mut self, tokens: &[String]) {
        let items = ["fn", "struct", "enum", "union", "trait", "type", "const", "static", "mod"];
        let is = |i: usize, what: &str| tokens.get(i).is_some_and(|token| token == what);
        // Modules with their own braces inside the file, each with the depth of its contents.
        let (mut depth, mut inside, mut i) = (0, Vec::<(String, i32)>::new(), 0);
        while i < tokens.len() {
            let here: Vec<_> = self.path.iter().chain(inside.iter().map(|(name, _)| name)).cloned().collect();
            match tokens[i].as_str() {
                "{" => depth += 1,
                "}" => {
                    depth -= 1;
                    inside.retain(|(_, level)| *level <= depth);
                }
                "mod" if is(i + 2, "{") => inside.push((tokens[i + 1].clone(), depth + 1)),
                "use" if !is(i + 1, "<") => {
                    let mut found = Vec::new();
                    i += 1;
                    import_tree(tokens, &mut i, &[], &mut found);
                    for import in &mut found {
                        import.path = absolute(&here, &import.path);
                        self.used.push(import.path.clone());
                    }
                    if depth == 0 {
                        self.imports.append(&mut found);
                    }
                    continue;
                }
                "crate" | "self" | "super" if is(i + 1, "::") && (i == 0 || !is(i - 1, "::")) => {
                    let mut path = vec![tokens[i].clone()];
                    while is(i + 1, "::")
                        && tokens.get(i + 2).is_some_and(|name| name.starts_with(char::is_alphabetic))
                    {
                        path.push(tokens[i + 2].clone());
                        i += 2;
                    }
                    self.used.push(absolute(&here, &path));
                }
                "macro_rules" if depth == 0 => {
                    self.items.insert(tokens[i + 2].clone());
                }
                keyword if depth == 0 && items.contains(&keyword) => {
                    self.items.insert(tokens[i + 1].clone());
                }
                _ => {}
            }
            i += 1;
        }
    }
}

/// A path as seen from the root. One that starts with another name leads to a part of the module or to another crate.
fn absolute(here: &[String], path: &[String]) -> Vec<String> {
    let mut base = here.to_vec();
    let mut rest = path;
    while let Some((first, after)) = rest.split_first() {
        match first.as_str() {
            "crate" => base.clear(),
            "super" => drop(base.pop()),
            "self" => {}
            _ => break,
        }
        rest = after;
    }
    base.into_iter().chain(rest.iter().cloned()).collect()
}

/// Index of the module with the longest path that is a prefix of this one.
fn containing(modules: &[Module], path: &[String]) -> Option<usize> {
    let contains = |&index: &usize| path.starts_with(&modules[index].path);
    (0..modules.len()).filter(contains).max_by_key(|&index| modules[index].path.len())
}

/// Index of the module whose file defines the item at a path. Follows at most `follow` re-exports.
fn defining(modules: &[Module], path: &[String], follow: u32) -> Option<usize> {
    let index = containing(modules, path)?;
    let module = &modules[index];
    let Some((name, rest)) = path[module.path.len()..].split_first() else { return Some(index) };
    if module.items.contains(name) {
        return Some(index);
    }
    let follow = follow.checked_sub(1)?;
    let continued = |import: &Import, name: Option<&String>| {
        let path: Vec<_> = import.path.iter().chain(name).chain(rest).cloned().collect();
        defining(modules, &path, follow)
    };
    if let Some(import) = module.imports.iter().find(|import| import.alias == *name) {
        // Another crate may define it; then nothing is found.
        return continued(import, None).or(Some(index));
    }
    module
        .imports
        .iter()
        .filter(|import| import.alias == "*")
        .find_map(|import| continued(import, Some(name)))
}

/// Imports among files: the files that each one uses, without those above and below it in the tree of modules.
fn arrows(modules: &[Module]) -> Vec<BTreeSet<usize>> {
    let related =
        |one: &Module, other: &Module| one.path.starts_with(&other.path) || other.path.starts_with(&one.path);
    let used = |module: &Module| {
        let found = module.used.iter();
        let found =
            found.filter_map(|path| defining(modules, path, 16).or_else(|| containing(modules, path)));
        found.filter(|&found| !related(module, &modules[found])).collect()
    };
    modules.iter().map(used).collect()
}

/// The shortest cycle through each import that is part of one, as text.
fn cycles(files: &[(String, String)]) -> BTreeSet<String> {
    let modules: Vec<_> = files.iter().map(|(file, text)| Module::new(file, text)).collect();
    let tests: Vec<_> = modules.iter().flat_map(|module| module.tests.clone()).collect();
    let tested = |module: &Module| tests.iter().any(|path| module.path.starts_with(path));
    let modules: Vec<_> = modules.into_iter().filter(|module| !tested(module)).collect();
    let arrows = arrows(&modules);
    let mut found = BTreeSet::new();
    for (from, to) in arrows.iter().enumerate().flat_map(|(from, all)| all.iter().map(move |&to| (from, to)))
    {
        let (mut before, mut queue) = (BTreeMap::from([(to, from)]), VecDeque::from([to]));
        while let Some(file) = queue.pop_front().filter(|&file| file != from) {
            for &next in &arrows[file] {
                before.entry(next).or_insert_with(|| {
                    queue.push_back(next);
                    file
                });
            }
        }
        let Some(&last) = before.get(&from) else { continue };
        let mut cycle = vec![from, last];
        while cycle.last() != Some(&from) {
            cycle.push(before[cycle.last().unwrap()]);
        }
        cycle.pop();
        cycle.reverse();
        let mut names: Vec<_> = cycle.iter().map(|&file| modules[file].file.as_str()).collect();
        let first = (0..names.len()).min_by_key(|&i| names[i]).unwrap();
        names.rotate_left(first);
        names.push(names[0]);
        found.insert(names.join(" -> "));
    }
    found
}

#[test]
fn files_of_a_crate_have_no_import_cycle() {
    let mut crates = BTreeMap::<String, Vec<(String, String)>>::new();
    for Source { text, name } in sources() {
        let (root, file) = name.rsplit_once("src/").unwrap();
        crates.entry(format!("{root}src/")).or_default().push((file.to_owned(), text));
    }
    let report = |(root, files): (&String, &Vec<_>)| {
        cycles(files).into_iter().map(|cycle| format!("{root}: {cycle}")).collect::<Vec<_>>()
    };
    none("files in an import cycle", &crates.iter().flat_map(report).collect::<Vec<_>>());
}

#[cfg(test)]
mod tests {
    use super::cycles;

    #[track_caller]
    fn check(files: &[(&str, &str)], expected: &[&str]) {
        let files: Vec<_> =
            files.iter().map(|(file, text)| ((*file).to_owned(), (*text).to_owned())).collect();
        assert_eq!(cycles(&files).into_iter().collect::<Vec<_>>(), expected);
    }

    #[test]
    fn cycles_through_nested_imports_and_paths_in_code() {
        check(
            &[
                ("lib.rs", "mod a; mod b; mod c;"),
                ("a.rs", "use crate::{b::{self, B}, c};"),
                ("b.rs", "use std::fmt; pub struct B;"),
                (
                    "c.rs",
                    "use ::a::b; fn c() { let x = \"}\"; let y: &'static str = super::a::A::new('\"'); }",
                ),
            ],
            &["a.rs -> c.rs -> a.rs"],
        );
        check(
            &[
                ("main.rs", "mod a; mod b; mod c;"),
                ("a.rs", "use crate::b::B;"),
                ("b.rs", "#[serde(with = \"crate::c\")] pub struct B;"),
                ("c.rs", "use super::a;"),
            ],
            &["a.rs -> b.rs -> c.rs -> a.rs"],
        );
    }

    #[test]
    fn cycles_through_reexports() {
        let room = [
            ("room/mod.rs", "mod deep; pub use deep::{Deep, other as another}; pub struct Room;"),
            ("room/deep.rs", "use crate::a::A; pub struct Deep; pub fn other() {}"),
            ("a.rs", "pub struct A; use crate::room::Room;"),
        ];
        let with = |root: &'static str, text: &'static str| {
            let mut files = vec![("lib.rs", root)];
            files.extend(room);
            files.last_mut().unwrap().1 = text;
            files
        };
        let cycle = ["a.rs -> room/deep.rs -> a.rs"];
        check(&with("mod a; mod room;", "use crate::room::Room; pub struct A;"), &[]);
        check(&with("mod a; mod room;", "use crate::room::another; pub struct A;"), &cycle);
        check(&with("mod a; mod room; pub use room::Deep;", "use crate::Deep; pub struct A;"), &cycle);
        check(&with("mod a; mod room; pub use room::*;", "fn a() -> crate::Deep { }"), &cycle);
        check(&with("mod a; mod room; pub use room::deep::*;", "use crate::{Deep as D, A};"), &cycle);
    }

    #[test]
    fn parents_parts_tests_and_comments_do_not_count() {
        check(
            &[
                ("lib.rs", "mod a; mod b; pub fn f() { b::f(); } #[cfg(test)] mod fixture;"),
                ("a/mod.rs", "mod part; use part::Part; pub struct A;"),
                ("a/part.rs", "use super::A; use crate::f; pub struct Part;"),
                (
                    "b.rs",
                    "// crate::c
                     /* crate::c /* nested */ crate::c */
                     fn s() { r#\"crate::c::C \"quoted\"\"#; }
                     #[cfg(test)] use crate::{c::C, fixture};
                     #[cfg(test)] #[expect(dead_code)] fn only_in_tests() { crate::c::C; }
                     fn f<'a>(x: &'a str) -> impl Sized + use<'a> { mod inner { use super::s; } }
                     #[cfg(test)] mod tests { use crate::c::C; }",
                ),
                ("c.rs", "use crate::b::f; pub struct C;"),
                ("fixture.rs", "use crate::b::f;"),
            ],
            &[],
        );
    }
}
