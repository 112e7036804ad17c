//! Checkpoints whose files were replaced, cut or changed, with a manifest that fits the damage or with one that does not.
//! Whatever is wrong with the newest, the one before it is loaded.
#![no_main]

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;

use arbitrary::{Arbitrary, Unstructured};
use learner::config::CheckpointConfig;
use learner::store::checkpoint::{self, Checkpoint, FileEntry, Manifest, RunSettings};
use libfuzzer_sys::fuzz_target;
use policy::arrays::{Array, NamedArrays, from_safetensors, hex};
use sha2::{Digest as _, Sha256};
use tempfile::TempDir;

thread_local! {
    static RUN: Run = Run::new();
}

fuzz_target!(|data: &[u8]| {
    // Too few bytes for a whole list of damages are no case.
    let _judged = RUN.with(|run| run.endure(&mut Unstructured::new(data)));
});

/// A run folder with two good checkpoints, and the newer one's files by name.
struct Run {
    folder: TempDir,
    good: BTreeMap<String, Vec<u8>>,
}

/// What happens to one file.
#[derive(Arbitrary, Debug)]
enum Damage<'a> {
    Replaced(&'a [u8]),
    Cut(u16),
    Changed(Vec<(u16, u8)>),
    Longer(&'a [u8]),
    Gone,
}

/// Whether somebody made the manifest fit what they did.
#[derive(Arbitrary, Debug, PartialEq, Eq)]
enum Seal {
    Broken,
    Files,
    Everything,
}

fn state(iteration: u64) -> Checkpoint {
    let floats = |value: f32| Array::F32 { shape: vec![2, 2], data: vec![value, 0.5, -0.0, 1e-9] };
    let count = Array::I64 { shape: vec![1], data: vec![iteration as i64] };
    let arrays = NamedArrays::from([
        ("weights/critic".to_owned(), floats(iteration as f32)),
        ("optimizer/critic.m".to_owned(), Array::F64 { shape: vec![1], data: vec![2.0] }),
        ("environments/0000/state".to_owned(), Array::U8 { shape: vec![3], data: vec![1, 2, 3] }),
        ("counters/iteration".to_owned(), count),
    ]);
    Checkpoint { iteration, env_steps: iteration * 40, arrays, policy: b"a policy".to_vec() }
}

impl Run {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder for checkpoints");
        let keep = CheckpointConfig { every: 1, keep_last: 2 };
        for iteration in [1, 2] {
            checkpoint::save(
                folder.path(),
                &state(iteration),
                RunSettings { sha256: "c0ffee", toml: "a = 1\n" },
                &keep,
                &mut |_, _| Ok(()),
            )
            .expect("the disk takes a checkpoint");
        }
        let mut run = Self { folder, good: BTreeMap::new() };
        for entry in fs::read_dir(run.place()).expect("it was just written") {
            let entry = entry.expect("it was just written");
            let name = entry.file_name().into_string().expect("plain names");
            run.good.insert(name, fs::read(entry.path()).expect("it was just written"));
        }
        run
    }

    fn place(&self) -> PathBuf {
        checkpoint::folder(self.folder.path()).join("iter_00000002")
    }

    fn endure(&self, unstructured: &mut Unstructured<'_>) -> arbitrary::Result<()> {
        let mut files = self.good.clone();
        let seal = Seal::arbitrary(unstructured)?;
        for _ in 0..unstructured.int_in_range(1..=3)? {
            let name = self.good.keys().nth(unstructured.choose_index(self.good.len())?);
            let name = name.expect("the index is one of theirs");
            damage(&mut files, name, Damage::arbitrary(unstructured)?);
        }
        if seal != Seal::Broken {
            forge(&mut files, &seal);
        }
        self.write(&files);
        self.judge(&files, &seal);
        Ok(())
    }

    fn write(&self, files: &BTreeMap<String, Vec<u8>>) {
        for name in self.good.keys() {
            let path = self.place().join(name);
            match files.get(name) {
                Some(bytes) => fs::write(path, bytes).expect("the disk takes a file"),
                None => drop(fs::remove_file(path)),
            }
        }
    }

    fn judge(&self, files: &BTreeMap<String, Vec<u8>>, seal: &Seal) {
        let newest = checkpoint::load_newest(self.folder.path()).expect("the first one stands");
        match newest.checkpoint.iteration {
            1 => {
                assert_eq!(newest.checkpoint, state(1));
                assert_eq!(newest.skipped.len(), 1);
                let error = checkpoint::load(&self.place()).expect_err("it was passed over");
                assert!(error.to_string().contains(&newest.skipped[0].1));
            }
            2 if *files == self.good => assert_eq!(newest.checkpoint, state(2)),
            2 => {
                assert_ne!(*seal, Seal::Broken, "a damaged checkpoint was loaded");
                assert_eq!(newest.saved().state_sha256, newest.manifest.state_sha256);
            }
            other => panic!("nobody wrote checkpoint {other}"),
        }
    }
}

fn damage(files: &mut BTreeMap<String, Vec<u8>>, name: &str, damage: Damage<'_>) {
    let Some(bytes) = files.get_mut(name) else { return };
    match damage {
        Damage::Replaced(by) => by.clone_into(bytes),
        Damage::Cut(at) => bytes.truncate(at.into()),
        Damage::Longer(by) => bytes.extend_from_slice(by),
        Damage::Gone => drop(files.remove(name)),
        Damage::Changed(changes) => {
            for (at, value) in changes {
                let at = usize::from(at).checked_rem(bytes.len());
                at.into_iter().for_each(|at| bytes[at] = value);
            }
        }
    }
}

const MANIFEST: &str = "manifest.json";

/// Writes a manifest that fits the files' bytes and, if asked to, the state that they hold.
fn forge(files: &mut BTreeMap<String, Vec<u8>>, seal: &Seal) {
    let Some(bytes) = files.get(MANIFEST) else { return };
    let Ok(mut manifest) = serde_json::from_slice::<Manifest>(bytes) else { return };
    for (name, entry) in &mut manifest.files {
        let Some(bytes) = files.get(name) else { continue };
        *entry = FileEntry { size: bytes.len() as u64, sha256: hex(&Sha256::digest(bytes)) };
    }
    if *seal == Seal::Everything {
        let own = manifest.files.keys().filter_map(|name| files.get(name));
        let groups = own.filter_map(|bytes| from_safetensors(bytes).ok());
        let arrays = groups.flat_map(|(group, _)| group).collect();
        let claimed = Checkpoint { iteration: 2, env_steps: 80, arrays, policy: Vec::new() };
        manifest.weights_sha256 = claimed.weights_sha256();
        manifest.state_sha256 = claimed.state_sha256();
    }
    manifest.manifest_sha256 = String::new();
    manifest.manifest_sha256 = hex(&Sha256::digest(text(&manifest)));
    files.insert(MANIFEST.to_owned(), text(&manifest));
}

fn text(manifest: &Manifest) -> Vec<u8> {
    let mut bytes = serde_json::to_vec_pretty(manifest).expect("plain values");
    bytes.push(b'\n');
    bytes
}
