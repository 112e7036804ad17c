//! Films: the formats that can be written, and ffmpeg, in whose place these tests have scripts.

use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;

use crate::runs::{Runs, failure, success, text};
use crate::teams::{TASK, within};

#[test]
fn an_extension_that_cannot_be_written_is_refused_with_those_that_can() {
    let runs = Runs::new();
    let folder = runs.folder("films");
    std::fs::create_dir(&folder).unwrap();
    for (more, parts) in [
        (&["--out", "a.avi"][..], ["--out a.avi", "name a .gif, .mp4 or .webm"]),
        (&["--out", "a.mp4", "--force"], ["--out a.mp4", "only ffmpeg writes this format"]),
        (&["--out", "a.gif", "--still"], ["--out a.gif", "the format of .png"]),
        (&["--frames", "65", "--still"], ["--frames 65", "at most 64 pictures"]),
        (&["--every-secs", "0.01"], ["--every-secs 0.01", "at least 0.02 s"]),
        (&["--frames", "2", "--from-secs", "50"], ["50.00 s to 50.05 s", "0 s to 50.00 s"]),
    ] {
        let arguments = [&["film", TASK], more].concat();
        let line = failure(within(&folder, &arguments).env("PATH", ""), 2);
        assert!(parts.iter().all(|part| line.contains(part)), "{more:?}: {line}");
    }
    assert_eq!(folder.read_dir().unwrap().count(), 0);
}

/// Puts a script with the name ffmpeg into `folder`.
fn install(folder: &Path, script: &str) {
    let path = folder.join("ffmpeg");
    std::fs::write(&path, format!("#!/bin/sh\n{script}\n")).unwrap();
    std::fs::set_permissions(&path, Permissions::from_mode(0o755)).unwrap();
}

#[test]
fn ffmpeg_gets_every_picture_and_its_error_is_shown() {
    let runs = Runs::new();
    let (folder, programs) = (runs.folder("films"), runs.folder("programs"));
    for made in [&folder, &programs] {
        std::fs::create_dir(made).unwrap();
    }
    let path = format!("{}:/usr/bin:/bin", text(&programs));
    let film = |frames: &str| {
        let mut film = within(&folder, &["film", TASK, "--out=a.mp4", "--frames", frames]);
        film.env("PATH", &path);
        film
    };
    // Fails before it reads, so that the program cannot send.
    install(&programs, "echo 'no encoder' >&2; exit 8");
    let line = failure(&mut film("60"), 1);
    assert!(line.contains("ffmpeg failed") && line.contains("no encoder"), "{line}");
    assert_eq!(folder.read_dir().unwrap().count(), 0);
    install(&programs, "for last; do :; done; cat > \"${last#file:}\"");
    success(&mut film("3"));
    let bytes = std::fs::read(folder.join("a.mp4")).unwrap();
    assert_eq!(bytes.len(), 3 * 480 * 300 * 4);
}
