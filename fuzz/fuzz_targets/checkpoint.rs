//! Checkpoints whose files were replaced, cut or changed, with a manifest that fits the damage or with one that does not.
//! Whatever is wrong with the newest, the one before it is loaded.
#![no_main]
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a finding")]

#[path = "../../learner/tests/checkpoint/run.rs"]
mod run;

use std::collections::BTreeMap;
use std::fs;

use arbitrary::{Arbitrary, Unstructured};
use learner::store::checkpoint::{self, Checkpoint, FileEntry, Manifest};
use libfuzzer_sys::fuzz_target;
use policy::arrays::{from_safetensors, hex};
use run::{Run, checkpoint, files, names};
use sha2::{Digest as _, Sha256};

thread_local! {
    static TWO: Two = Two::new();
}

fuzz_target!(|data: &[u8]| {
    // Too few bytes for a whole list of damages are no case.
    let _checked = TWO.with(|two| two.check(&mut Unstructured::new(data)));
});

/// A run with two good checkpoints, and the newer one's files by name.
struct Two {
    run: Run,
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

/// How far the manifest is changed to fit the damage.
#[derive(Arbitrary, Debug, PartialEq, Eq)]
enum Seal {
    Broken,
    Files,
    Everything,
}

impl Two {
    fn new() -> Self {
        let run = Run::with(&[1, 2]);
        let place = run.path(2);
        let bytes = files(&place).into_iter().map(|file| fs::read(file).unwrap());
        let good = names(&place).into_iter().zip(bytes).collect();
        Self { run, good }
    }

    fn check(&self, unstructured: &mut Unstructured<'_>) -> arbitrary::Result<()> {
        let mut files = self.good.clone();
        let seal = Seal::arbitrary(unstructured)?;
        for _ in 0..unstructured.int_in_range(1..=3)? {
            let name = self.good.keys().nth(unstructured.choose_index(self.good.len())?);
            let name = name.unwrap();
            damage(&mut files, name, Damage::arbitrary(unstructured)?);
        }
        if seal != Seal::Broken {
            forge(&mut files, &seal);
        }
        self.write(&files);
        self.check_loaded(&files, &seal);
        Ok(())
    }

    fn write(&self, files: &BTreeMap<String, Vec<u8>>) {
        for name in self.good.keys() {
            let path = self.run.path(2).join(name);
            match files.get(name) {
                Some(bytes) => fs::write(path, bytes).unwrap(),
                None => drop(fs::remove_file(path)),
            }
        }
    }

    fn check_loaded(&self, files: &BTreeMap<String, Vec<u8>>, seal: &Seal) {
        let newest = self.run.load();
        match newest.checkpoint.iteration {
            1 => {
                assert_eq!(newest.checkpoint, checkpoint(1));
                assert_eq!(newest.skipped.len(), 1);
                let error = checkpoint::load(&self.run.path(2)).unwrap_err();
                assert!(error.to_string().contains(&newest.skipped[0].1));
            }
            2 if *files == self.good => assert_eq!(newest.checkpoint, checkpoint(2)),
            2 => {
                assert_ne!(*seal, Seal::Broken, "a damaged checkpoint was loaded");
                assert_eq!(newest.saved().state_sha256, newest.manifest.state_sha256);
            }
            other => panic!("checkpoint {other} was never written"),
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
