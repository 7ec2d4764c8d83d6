//! Reads the imports between the files of a source folder from their text. An import is a `use` tree, or a path that
//! begins with `crate`, `super`, `self` or the crate's own name. Test code is left out. A re-export is followed to its
//! file.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
};

/// Path of a module, as the names from the crate's root on.
pub type Module = Vec<String>;

/// A path in the text of a file.
#[derive(Clone, Debug)]
struct Named {
    line: usize,
    /// The module in whose code the path stands.
    from: Module,
    path: Vec<String>,
}

/// A file, and the paths that it names.
#[derive(Debug, Default)]
struct File {
    name: String,
    named: Vec<Named>,
    /// Names that `use` defines in this file, each with its path.
    bound: BTreeMap<String, Named>,
}

/// One import. It has the importing module with its file and line, and the imported module.
#[derive(Clone, Debug)]
pub struct Import {
    pub from: Module,
    pub to: Module,
    pub file: String,
    pub line: usize,
}

/// The files of a crate by module. The root's files are left out.
#[derive(Debug)]
pub struct Source {
    own_names: &'static [&'static str],
    files: BTreeMap<Module, File>,
}

impl Source {
    /// Reads `folders` of the workspace. The code in these folders names their crates by `own_names`. Several folders
    /// are treated as one crate, so their modules must have different names.
    pub fn read(folders: &[&str], own_names: &'static [&'static str]) -> Self {
        let mut texts = vec![];
        for folder in folders {
            let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(folder);
            collect(&root, folder, &mut texts);
        }
        Self::of(texts, folders, own_names)
    }

    /// Does the same as [`read`](Self::read) for given texts, each with its path.
    pub fn of(
        texts: Vec<(String, String)>,
        folders: &[&str],
        own_names: &'static [&'static str],
    ) -> Self {
        let mut source = Self { own_names, files: BTreeMap::new() };
        let mut tests = BTreeSet::new();
        for (name, text) in texts {
            let module =
                module_of(folders.iter().find_map(|folder| name.strip_prefix(folder)).unwrap());
            let file = source.files.entry(module.clone()).or_default();
            file.name = name;
            Reader {
                tokens: tokens(&text),
                at: 0,
                own_names,
                file,
                inline: vec![],
                tests: &mut tests,
            }
            .read(&module);
        }
        let of_test = |module: &Module| (1..=module.len()).any(|n| tests.contains(&module[..n]));
        source.files.retain(|module, _| !of_test(module));
        source
    }

    /// File and line of each path that begins with one of the `own_names`. Test code is left out.
    pub fn mentions(&self) -> Vec<(&str, usize)> {
        let mut found = vec![];
        for file in self.files.values() {
            let own = file.named.iter().filter(|named| self.own_names.contains(&&*named.path[0]));
            found.extend(own.map(|named| (file.name.as_str(), named.line)));
        }
        found
    }

    pub fn imports(&self) -> Vec<Import> {
        let mut imports = vec![];
        for (module, file) in self.files.iter().filter(|(module, _)| !module.is_empty()) {
            for named in &file.named {
                let Some(to) = self.resolve(named, 0) else { continue };
                if to != *module && !to.is_empty() {
                    let (from, file) = (module.clone(), file.name.clone());
                    imports.push(Import { from, to, file, line: named.line });
                }
            }
        }
        imports
    }

    /// The file that a path leads to.
    fn resolve(&self, named: &Named, depth: usize) -> Option<Module> {
        let mut at = named.from.clone();
        let mut rest = &named.path[..];
        match rest.first()?.as_str() {
            "crate" => at.clear(),
            own if self.own_names.contains(&own) => at.clear(),
            "self" => {}
            "super" => drop(at.pop()),
            first => {
                let child = [&at[..], &[first.to_owned()]].concat();
                let bound = self.files.get(&at).is_some_and(|file| file.bound.contains_key(first));
                if !bound && !self.files.contains_key(&child) {
                    return None; // another crate
                }
                return self.walk(at, rest, depth);
            }
        }
        rest = &rest[1..];
        while let ["super", ..] = rest.iter().map(String::as_str).take(1).collect::<Vec<_>>()[..] {
            at.pop();
            rest = &rest[1..];
        }
        self.walk(at, rest, depth)
    }

    fn walk(&self, mut at: Module, mut rest: &[String], depth: usize) -> Option<Module> {
        while let [next, ..] = rest {
            let child = [&at[..], std::slice::from_ref(next)].concat();
            if self.files.contains_key(&child) {
                (at, rest) = (child, &rest[1..]);
                continue;
            }
            if let Some(bound) = self.files.get(&at).and_then(|file| file.bound.get(next))
                && depth < 8
            {
                let path = [&bound.path[..], &rest[1..]].concat();
                return self.resolve(&Named { path, ..bound.clone() }, depth + 1);
            }
            break;
        }
        // An inline module belongs to its file.
        while !self.files.contains_key(&at) && !at.is_empty() {
            at.pop();
        }
        Some(at)
    }
}

/// Path and text of the files below `folder`. The paths begin with `name`.
fn collect(folder: &Path, name: &str, texts: &mut Vec<(String, String)>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = format!("{name}/{}", path.file_name().unwrap().to_str().unwrap());
        if path.is_dir() {
            collect(&path, &name, texts);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            texts.push((name, fs::read_to_string(&path).unwrap()));
        }
    }
}

/// The module of a file below the crate's root.
fn module_of(file: &str) -> Module {
    let parts = file.trim_end_matches(".rs").split('/');
    parts.filter(|part| !["", "lib", "main", "mod"].contains(part)).map(str::to_owned).collect()
}

/// Splits a text into words and signs, each with its line. Comments, strings and characters are left out.
fn tokens(text: &str) -> Vec<(usize, String)> {
    let mut tokens = vec![];
    let (mut rest, mut line) = (text, 1);
    while let Some(first) = rest.chars().next() {
        let word = |text: &str| {
            text.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(text.len())
        };
        let length = if first == '"' || raw_string(rest).is_some() {
            string(rest)
        } else if rest.starts_with("//") {
            rest.find('\n').unwrap_or(rest.len())
        } else if rest.starts_with("/*") {
            rest.find("*/").map_or(rest.len(), |end| end + 2)
        } else if first == '\'' {
            character(rest)
        } else if word(rest) > 0 {
            tokens.push((line, rest[..word(rest)].to_owned()));
            word(rest)
        } else if rest.starts_with("::") {
            tokens.push((line, "::".to_owned()));
            2
        } else {
            if !first.is_whitespace() {
                tokens.push((line, first.to_string()));
            }
            first.len_utf8()
        };
        line += rest[..length].matches('\n').count();
        rest = &rest[length..];
    }
    tokens
}

/// The text that ends the raw string that begins here. `None` if no raw string begins here.
fn raw_string(text: &str) -> Option<String> {
    let rest = text.strip_prefix("br").or_else(|| text.strip_prefix('r'))?;
    let hashes = rest.len() - rest.trim_start_matches('#').len();
    rest[hashes..].starts_with('"').then(|| format!("\"{}", "#".repeat(hashes)))
}

fn string(text: &str) -> usize {
    let start = text.find('"').unwrap() + 1;
    if let Some(end) = raw_string(text) {
        return text[start..].find(&end).map_or(text.len(), |at| start + at + end.len());
    }
    let mut escaped = false;
    for (at, c) in text[start..].char_indices() {
        match c {
            '"' if !escaped => return start + at + 1,
            _ => escaped = c == '\\' && !escaped,
        }
    }
    text.len()
}

/// Length of a character literal such as `'x'` or `'\n'`, or of the sign `'` before a lifetime.
fn character(text: &str) -> usize {
    let mut chars = text.char_indices().skip(1);
    match chars.next() {
        Some((_, '\\')) => text[3..].find('\'').map_or(1, |at| at + 4),
        Some(_) => match chars.next() {
            Some((at, '\'')) => at + 1,
            _ => 1,
        },
        None => 1,
    }
}

/// Reads the tokens of a file.
struct Reader<'a> {
    tokens: Vec<(usize, String)>,
    at: usize,
    own_names: &'static [&'static str],
    file: &'a mut File,
    /// Inline modules that are open, each with the number of braces that are open around it.
    inline: Vec<(String, usize)>,
    /// Modules that are compiled for tests only.
    tests: &'a mut BTreeSet<Module>,
}

impl Reader<'_> {
    fn text(&self, ahead: usize) -> &str {
        self.tokens.get(self.at + ahead).map_or("", |(_, text)| text)
    }

    fn read(mut self, module: &Module) {
        let mut braces = 0;
        while self.at < self.tokens.len() {
            let within =
                || self.inline.iter().map(|(name, _)| name.clone()).collect::<Vec<String>>();
            let from = [&module[..], &within()].concat();
            match self.text(0) {
                "#" if self.is_for_tests() => {
                    self.skip_item(&from);
                    continue;
                }
                "use" => {
                    self.at += 1;
                    self.tree(&from, &[]);
                    continue;
                }
                "mod" if self.text(2) == "{" => {
                    self.inline.push((self.text(1).to_owned(), braces));
                    self.at += 1;
                }
                "{" => braces += 1,
                "}" => {
                    braces -= 1;
                    self.inline.retain(|(_, around)| *around < braces);
                }
                "crate" | "super" | "self" if self.text(1) == "::" => {
                    self.path(&from);
                    continue;
                }
                own if self.own_names.contains(&own) && self.text(1) == "::" => {
                    self.path(&from);
                    continue;
                }
                _ => {}
            }
            self.at += 1;
        }
    }

    fn is_for_tests(&self) -> bool {
        let text: String = (0..7).map(|ahead| self.text(ahead)).collect();
        text.starts_with("#[cfg(test)]") || text.starts_with("#[cfg(all(test")
    }

    /// Skips attributes and the item after them.
    fn skip_item(&mut self, from: &Module) {
        while self.text(0) == "#" {
            self.at += 1;
            self.skip_group("[", "]");
        }
        while !["{", ";", ""].contains(&self.text(0)) {
            if self.text(0) == "mod" {
                self.tests.insert([&from[..], &[self.text(1).to_owned()]].concat());
            }
            self.at += 1;
        }
        if self.text(0) == "{" {
            self.skip_group("{", "}");
        }
    }

    fn skip_group(&mut self, open: &str, close: &str) {
        let mut depth = 0;
        while self.at < self.tokens.len() {
            depth += usize::from(self.text(0) == open);
            depth -= usize::from(self.text(0) == close);
            self.at += 1;
            if depth == 0 {
                return;
            }
        }
    }

    fn path(&mut self, from: &Module) {
        let line = self.tokens[self.at].0;
        let mut path = vec![self.text(0).to_owned()];
        while self.text(1) == "::" && self.text(2).starts_with(|c: char| c.is_alphabetic()) {
            path.push(self.text(2).to_owned());
            self.at += 2;
        }
        self.at += 1;
        self.file.named.push(Named { line, from: from.clone(), path });
    }

    /// Reads a tree of `use` after `path`, up to the comma, brace or semicolon at the end of the tree.
    fn tree(&mut self, from: &Module, path: &[String]) {
        let mut path = path.to_vec();
        loop {
            let line = self.tokens[self.at].0;
            let token = self.text(0).to_owned();
            self.at += 1;
            match token.as_str() {
                "{" => {
                    while self.text(0) != "}" {
                        self.tree(from, &path);
                        if self.text(0) == "," {
                            self.at += 1;
                        }
                    }
                    self.at += 1;
                    return;
                }
                "::" => {}
                "*" => {
                    self.file.named.push(Named { line, from: from.clone(), path });
                    return;
                }
                _ => {
                    if token != "self" || path.is_empty() {
                        path.push(token);
                    }
                    if self.text(0) == "::" {
                        continue;
                    }
                    let mut name = path[path.len() - 1].clone();
                    if self.text(0) == "as" {
                        self.text(1).clone_into(&mut name);
                        self.at += 2;
                    }
                    let named = Named { line, from: from.clone(), path };
                    self.file.named.push(named.clone());
                    self.file.bound.insert(name, named);
                    return;
                }
            }
        }
    }
}
