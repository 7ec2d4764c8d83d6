//! The commit that an image reports, as build.rs reads it from a repository.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

#[allow(dead_code, reason = "the rest of it makes files")]
#[path = "../../build.rs"]
mod build_script;

/// A temporary folder, which is removed when the value is dropped.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("commit-{name}"));
        let _ = fs::remove_dir_all(&folder); // left by a test that was killed
        fs::create_dir_all(folder.join("src")).unwrap();
        Self(folder)
    }

    /// A repository with `src/main.rs` and `page.md` committed.
    fn committed(name: &str) -> Self {
        let folder = Self::new(name);
        folder.git(&["init", "--quiet"]);
        folder.write("src/main.rs", "fn main() {}");
        folder.write("page.md", "a page");
        folder.commit();
        folder
    }

    fn write(&self, file: &str, text: &str) {
        fs::write(self.0.join(file), text).unwrap();
    }

    fn git(&self, words: &[&str]) -> String {
        let names = ["-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false"];
        let told = Command::new("git").current_dir(&self.0).args(names).args(words).output();
        let told = told.unwrap();
        assert!(told.status.success(), "{}", String::from_utf8_lossy(&told.stderr));
        String::from_utf8(told.stdout).unwrap().trim().to_owned()
    }

    fn commit(&self) -> String {
        self.git(&["add", "--all"]);
        self.git(&["commit", "--quiet", "--message", "one"]);
        self.head()
    }

    fn head(&self) -> String {
        self.git(&["rev-parse", "HEAD"])[..12].to_owned()
    }

    fn said(&self) -> String {
        build_script::commit(&self.0).0
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

#[test]
fn the_commit_is_that_of_the_package_and_dirty_what_the_image_is_made_of() {
    let folder = Folder::committed("dirty");
    let first = folder.head();
    assert_eq!(folder.said(), first);
    folder.write("page.md", "another page");
    assert_eq!(folder.said(), first, "a page is not in the image");
    folder.write("src/main.rs", "fn main() {} // changed");
    assert_eq!(folder.said(), format!("{first}-dirty"));
    let second = folder.commit();
    assert_ne!(first, second);
    assert_eq!(folder.said(), second);
    folder.write("src/new.rs", "// not committed");
    assert_eq!(folder.said(), format!("{second}-dirty"));
}

#[test]
fn without_a_repository_of_its_own_the_commit_is_unknown() {
    let around = Folder::committed("around");
    let archive = around.0.join("archive");
    fs::create_dir_all(archive.join("src")).unwrap();
    let (said, watched) = build_script::commit(&archive);
    assert_eq!(said, "unknown", "the commit of the repository around it");
    assert!(watched.contains(&archive.join("src")), "{watched:?}");
}

/// A commit changes a file that the build watches, and so does a change of the branch. Every watched file exists: if
/// one were missing, cargo would build again each time.
#[test]
fn what_changes_the_commit_is_watched() {
    let folder = Folder::committed("watched");
    let texts = || {
        let (_, watched) = build_script::commit(&folder.0);
        assert!(watched.iter().all(|path| path.exists()), "{watched:?}");
        let files = watched.into_iter().filter(|path| path.is_file());
        files.map(|path| (fs::read(&path).unwrap(), path)).collect::<Vec<_>>()
    };
    let before = texts();
    folder.write("page.md", "another page");
    folder.commit();
    let committed = texts();
    assert_ne!(before, committed);
    folder.git(&["checkout", "--quiet", "-b", "other"]);
    assert_ne!(committed, texts());
    let (_, watched) = build_script::commit(&folder.0);
    assert!(watched.contains(&folder.0.join("src")), "{watched:?}");
}
