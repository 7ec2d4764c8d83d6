use super::*;

const NAMES: [&str; 3] = ["x.csv", "y.csv", MANIFEST];

fn write(folder: &Path, files: &[&str], text: &[u8], force: bool) -> Result<(), Error> {
    let mut outputs = Outputs::new(force, &[]);
    let to = outputs.folder(folder, Units::Linear, &NAMES)?;
    for name in files {
        outputs.add(to, name, String::from_utf8_lossy(text).into_owned())?;
    }
    outputs.commit()
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name());
    let mut names: Vec<String> = entries.map(|name| name.into_string().unwrap()).collect();
    names.sort();
    names
}

/// Writes one file, completely or not at all.
fn write_file(path: &Path, bytes: &[u8], force: bool) -> Result<(), Error> {
    let mut outputs = Outputs::new(force, &[]);
    let file = outputs.file(path)?;
    outputs.write(file, bytes)?;
    outputs.commit()
}

#[test]
fn a_result_that_is_not_committed_leaves_no_trace() {
    let root = tempfile::tempdir().unwrap();
    let mut outputs = Outputs::new(false, &[]);
    let to = outputs.folder(&root.path().join("a/b"), Units::Linear, &NAMES).unwrap();
    outputs.add(to, "x.csv", "1".into()).unwrap();
    outputs.file(&root.path().join("c/d.csv")).unwrap();
    assert_eq!(names(&root.path().join("a/b")).len(), 2);
    drop(outputs);
    assert_eq!(names(root.path()), [""; 0]);
}

#[test]
fn results_are_replaced_only_with_force_and_other_files_stay() {
    let root = tempfile::tempdir().unwrap();
    let both = ["x.csv", MANIFEST];
    fs::write(root.path().join("mine.txt"), "mine").unwrap();
    write(root.path(), &both, b"1", false).unwrap();
    let refused = write(root.path(), &both, b"2", false).unwrap_err();
    assert_eq!(refused.exit_code(), 2);
    assert!(refused.to_string().contains("holds a result already (x.csv)"), "{refused}");
    assert_eq!(fs::read(root.path().join("x.csv")).unwrap(), b"1");
    write(root.path(), &both, b"3", true).unwrap();
    assert_eq!(fs::read(root.path().join(MANIFEST)).unwrap(), b"3");
    assert_eq!(names(root.path()), [MANIFEST, "mine.txt", "x.csv"]);
}

#[test]
fn a_new_result_leaves_nothing_of_the_old_one() {
    let root = tempfile::tempdir().unwrap();
    write(root.path(), &NAMES, b"1", false).unwrap();
    write(root.path(), &["x.csv", MANIFEST], b"2", true).unwrap();
    assert_eq!(names(root.path()), [MANIFEST, "x.csv"]);
}

#[test]
fn what_is_no_plain_file_is_refused_before_anything_is_touched() {
    let root = tempfile::tempdir().unwrap();
    fs::write(root.path().join(MANIFEST), "old").unwrap();
    let mut outputs = Outputs::new(true, &[]);
    let to = outputs.folder(root.path(), Units::Linear, &NAMES).unwrap();
    outputs.add(to, "x.csv", "new".into()).unwrap();
    outputs.add(to, MANIFEST, "new".into()).unwrap();
    fs::create_dir(root.path().join("x.csv")).unwrap();
    assert_eq!(outputs.commit().unwrap_err().exit_code(), 2);
    assert_eq!(fs::read(root.path().join(MANIFEST)).unwrap(), b"old");
    assert_eq!(names(root.path()), [MANIFEST, "x.csv"]);
    assert!(write(root.path(), &NAMES, b"", true).is_err());
    assert!(write_file(&root.path().join("x.csv"), b"", true).is_err());
}

#[test]
fn a_result_that_fails_half_way_leaves_the_old_one() {
    let root = tempfile::tempdir().unwrap();
    let (result, other) = (root.path().join("result"), root.path().join("other"));
    write(&result, &NAMES, b"old", false).unwrap();
    let mut outputs = Outputs::new(true, &[]);
    let to = outputs.folder(&result, Units::Linear, &NAMES).unwrap();
    outputs.add(to, "x.csv", "new".into()).unwrap();
    outputs.add(to, MANIFEST, "new".into()).unwrap();
    let first = outputs.file(&root.path().join("first.csv")).unwrap();
    let last = outputs.file(&other.join("last.csv")).unwrap();
    outputs.write(first, b"new").unwrap();
    outputs.write(last, b"new").unwrap();
    fs::remove_dir_all(&other).unwrap(); // another program removes the folder
    assert_eq!(outputs.commit().unwrap_err().exit_code(), 1);
    assert_eq!(names(root.path()), ["result"]);
    assert_eq!(names(&result), [MANIFEST, "x.csv", "y.csv"]);
    for name in NAMES {
        assert_eq!(fs::read(result.join(name)).unwrap(), b"old", "{name}");
    }
}

#[cfg(unix)]
#[test]
fn a_link_is_not_replaced_and_an_input_is_found_by_any_name() {
    use std::os::unix::fs::symlink;
    let root = tempfile::tempdir().unwrap();
    let [link, input, hard, soft] =
        ["link.csv", "in.toml", "hard.toml", "soft"].map(|n| root.path().join(n));
    symlink("nowhere", &link).unwrap();
    assert!(write_file(&link, b"", true).is_err());
    assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    fs::write(&input, "input").unwrap();
    fs::hard_link(&input, &hard).unwrap();
    symlink(root.path(), &soft).unwrap();
    for name in [&input, &hard, &soft.join("in.toml"), &root.path().join("./in.toml")] {
        let mut outputs = Outputs::new(true, std::slice::from_ref(&input));
        let refused = outputs.file(name).unwrap_err().to_string();
        assert!(refused.contains("is the input"), "{refused}");
    }
    let mut outputs = Outputs::new(true, &[]);
    outputs.file(&root.path().join("new.csv")).unwrap();
    for (path, same) in [
        (soft.join("new.csv"), true),
        (root.path().join("./new.csv"), true),
        (soft.join("b"), false),
    ] {
        let second = outputs.file(&path).map_err(|error| error.to_string());
        assert_eq!(second.is_err_and(|error| error.contains("the same file")), same, "{path:?}");
    }
    outputs.file(&hard).unwrap();
    assert!(outputs.file(&input).unwrap_err().to_string().contains("the same file"));
}

#[test]
fn a_place_that_is_being_written_is_refused_and_left_overs_go() {
    let root = tempfile::tempdir().unwrap();
    let left_over = root.path().join(".zwidth-a.csv.draft");
    fs::write(&left_over, "of a killed run").unwrap();
    fs::write(root.path().join(".zwidth-mine"), "").unwrap();
    let mut first = Outputs::new(false, &[]);
    let place = first.file(&root.path().join("b.csv")).unwrap();
    assert!(!left_over.exists());
    let refused = Outputs::new(true, &[]).file(&root.path().join("b.csv")).unwrap_err();
    assert!(refused.to_string().contains("is being written by another run"), "{refused}");
    write_file(&root.path().join("a.csv"), b"a", false).unwrap();
    first.write(place, b"b").unwrap();
    first.commit().unwrap();
    assert_eq!(names(root.path()), [".zwidth-mine", "a.csv", "b.csv"]);
}

#[test]
fn a_file_is_written_whole_and_not_replaced_unasked() {
    let root = tempfile::tempdir().unwrap();
    let path = root.path().join("new/trace.csv");
    write_file(&path, b"1", false).unwrap();
    assert!(write_file(&path, b"2", false).is_err());
    write_file(&path, b"2", true).unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"2");
    assert_eq!(names(path.parent().unwrap()), ["trace.csv"]);
}

#[test]
fn a_place_that_cannot_be_one_is_bad_input() {
    let root = tempfile::tempdir().unwrap();
    let file = root.path().join("file");
    fs::write(&file, "").unwrap();
    assert_eq!(write(&file.join("x"), &[], b"", true).unwrap_err().exit_code(), 2);
    for path in
        [file.join("x"), "".into(), "/".into(), root.path().join("new/"), root.path().join("..")]
    {
        assert_eq!(write_file(&path, b"", true).unwrap_err().exit_code(), 2, "{path:?}");
    }
}
