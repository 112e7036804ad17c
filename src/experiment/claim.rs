//! Claims: a file beside a run's folder names the process that computes the run, so that processes on any number of
//! hosts share an experiment's folder. The clocks of two hosts are never compared.

mod file;
#[cfg(test)]
mod tests;

use std::fs::File;
use std::hash::{BuildHasher as _, Hasher as _, RandomState};
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context as _;
use learner::plain_file;
use tokio::sync::watch;
use tokio::task::AbortHandle;
use tokio::time::{Instant, sleep};

pub(crate) use file::Holder;
use file::{BYTES, is_at, open, read, try_lock, write};

/// Longest host name that is written; Linux has at most 64 bytes.
const HOST_CHARS: usize = 200;

/// The name of this host, which containers set too, and the id that the kernel draws at its start.
const HOST_FILES: [&str; 2] = ["/proc/sys/kernel/hostname", "/proc/sys/kernel/random/boot_id"];

/// Durations of the protocol.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Times {
    /// Interval at which a holder rewrites its claim.
    pub(crate) beat: Duration,
    /// A claim of another host that is not locked and has not changed for this long is abandoned.
    pub(crate) stale: Duration,
    /// Wait after writing to another host's claim. The last of several writers gets it.
    pub(crate) settle: Duration,
    /// Wait before the second attempt to lock. A process that only judges a claim locks it for a moment.
    pub(crate) retry: Duration,
    /// Poll interval for a claim that another process holds.
    pub(crate) poll: Duration,
}

impl Default for Times {
    fn default() -> Self {
        Self {
            beat: Duration::from_secs(10),
            stale: Duration::from_secs(60),
            settle: Duration::from_secs(2),
            retry: Duration::from_millis(20),
            poll: Duration::from_millis(200),
        }
    }
}

/// This process, which claims runs.
#[derive(Clone, Debug)]
pub(crate) struct Claimant {
    host: String,
    boot: String,
    times: Times,
}

/// The contents of another host's claim and when they were first read.
#[derive(Debug)]
pub(crate) struct Sighting {
    holder: Holder,
    since: Instant,
}

/// Result of an attempt to claim a run.
#[derive(Debug)]
pub(crate) enum Attempt {
    /// This process has the claim.
    Claimed(Claim),
    /// A living process has it.
    Held(Holder),
    /// The file does not say yet whether its process lives: try again with this sighting.
    Unclear(Sighting),
}

/// A claim that this process holds and renews. It is released when dropped.
#[derive(Debug)]
pub(crate) struct Claim {
    path: PathBuf,
    id: String,
    file: File,
    lost: watch::Receiver<bool>,
    beats: AbortHandle,
}

impl Claimant {
    /// This process on this host.
    pub(crate) fn of_this_host() -> Self {
        let [host, boot] = HOST_FILES.map(|path| std::fs::read_to_string(path).unwrap_or_default());
        let host = host.trim().chars().take(HOST_CHARS).collect::<String>();
        let host = if host.is_empty() { "unnamed".to_owned() } else { host };
        Self { host, boot: boot.trim().to_owned(), times: Times::default() }
    }

    /// Tries to claim `path`; `seen` is the sighting of the previous attempt. Call inside a runtime.
    ///
    /// # Errors
    /// Names a file that cannot be written or locked.
    pub(crate) async fn claim(
        &self,
        path: &Path,
        seen: Option<Sighting>,
    ) -> anyhow::Result<Attempt> {
        loop {
            let Some((file, new)) = open(path)? else { continue };
            let locked = try_lock(&file, path)? || {
                sleep(self.times.retry).await;
                try_lock(&file, path)?
            };
            if !locked {
                return Ok(Attempt::Held(read(path)?.unwrap_or_default()));
            }
            // Another process may have removed the file between its opening and its lock.
            if !is_at(&file, path) {
                continue;
            }
            let holder = read(path)?.unwrap_or_default();
            return match seen {
                _ if new || self.is_here(&holder) => Ok(Attempt::Claimed(self.hold(path, file)?)),
                Some(seen) if seen.holder != holder => Ok(Attempt::Held(holder)),
                Some(seen) if seen.since.elapsed() >= self.times.stale => {
                    self.take_over(path, file).await
                }
                Some(seen) => Ok(Attempt::Unclear(seen)),
                None => Ok(Attempt::Unclear(Sighting { holder, since: Instant::now() })),
            };
        }
    }

    /// Waits until this process has the claim. Call inside a runtime.
    ///
    /// # Errors
    /// Names a file that cannot be written or locked.
    pub(crate) async fn wait(&self, path: &Path) -> anyhow::Result<Claim> {
        let mut seen = None;
        loop {
            match self.claim(path, seen.take()).await? {
                Attempt::Claimed(claim) => return Ok(claim),
                Attempt::Held(_) => {}
                Attempt::Unclear(sighting) => seen = Some(sighting),
            }
            sleep(self.times.poll).await;
        }
    }

    /// The process that holds the claim at `path`. A dead process of this host holds nothing; a dead process of another
    /// host does until its claim is taken over.
    pub(crate) fn holder(&self, path: &Path) -> Option<Holder> {
        let file = plain_file::open(File::options().read(true).write(true), path).ok()?;
        let holder = read(path).ok()??;
        let dead = self.is_here(&holder) && file.try_lock().is_ok();
        (!dead && !holder.host.is_empty()).then_some(holder)
    }

    fn is_here(&self, holder: &Holder) -> bool {
        !self.boot.is_empty() && (&holder.host, &holder.boot) == (&self.host, &self.boot)
    }

    /// Without locks between hosts, two of them may do this at the same time.
    async fn take_over(&self, path: &Path, file: File) -> anyhow::Result<Attempt> {
        let claim = self.hold(path, file)?;
        sleep(self.times.settle).await;
        match read(path)?.unwrap_or_default() {
            holder if holder.id == claim.id => Ok(Attempt::Claimed(claim)),
            holder => Ok(Attempt::Held(holder)),
        }
    }

    /// Writes this process into the locked file and starts to renew it.
    fn hold(&self, path: &Path, file: File) -> anyhow::Result<Claim> {
        let cannot_write = || format!("cannot write {}", path.display());
        let id = format!("{:016x}", RandomState::new().build_hasher().finish());
        let (host, boot, pid) = (self.host.clone(), self.boot.clone(), std::process::id());
        let holder = Holder { host, boot, pid, id: id.clone(), beat: 0 };
        file.set_len(BYTES as u64).with_context(cannot_write)?;
        write(&file, &holder).with_context(cannot_write)?;
        let (lost_sender, lost) = watch::channel(false);
        let shared = file.try_clone().with_context(cannot_write)?;
        let beats = renew(shared, path.to_path_buf(), holder, self.times.beat, lost_sender);
        let beats = tokio::spawn(beats).abort_handle();
        Ok(Claim { path: path.to_path_buf(), id, file, lost, beats })
    }
}

impl Claim {
    /// Waits until another process has the claim, which happens only if this one did not renew it for a long time.
    pub(crate) async fn lost(&self) -> Holder {
        if self.lost.clone().wait_for(|lost| *lost).await.is_err() {
            std::future::pending::<()>().await;
        }
        read(&self.path).ok().flatten().unwrap_or_default()
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        self.beats.abort();
        if read(&self.path).is_ok_and(|holder| holder.is_some_and(|holder| holder.id == self.id)) {
            // A file that stays is taken over, because it is not locked.
            let _removed = std::fs::remove_file(&self.path);
        }
        let _unlocked = self.file.unlock();
    }
}

/// Rewrites the claim until it contains another process, or is gone.
async fn renew(
    file: File,
    path: PathBuf,
    mut holder: Holder,
    every: Duration,
    lost: watch::Sender<bool>,
) {
    loop {
        sleep(every).await;
        let renewed = match read(&path) {
            Ok(Some(found)) if found.id == holder.id => {
                holder.beat += 1;
                write(&file, &holder)
                    .with_context(|| format!("cannot renew the claim {}", path.display()))
            }
            Ok(_) => {
                lost.send_replace(true);
                return;
            }
            Err(error) => Err(error),
        };
        if let Err(error) = renewed {
            tracing::warn!("{error:#}; the next attempt is in {} s", every.as_secs());
        }
    }
}
