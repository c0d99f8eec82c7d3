//! Chromium without a window.

use std::{
    fs::{self, File},
    io,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    time::Duration,
};

use anyhow::Context;

use super::arguments::Size;
use crate::cli::console::Usage;

/// Names under which it is installed.
const NAMES: [&str; 5] =
    ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome"];
/// How often is looked whether it still runs.
const LOOK_EVERY: Duration = Duration::from_millis(250);

/// A browser that is installed.
pub(super) struct Browser {
    pub(super) program: PathBuf,
}

impl Browser {
    /// The browser that is named, or the first of the usual names that can be started.
    pub(super) fn find(named: Option<&Path>) -> Result<Self, Usage> {
        let runs = |program: &Path| {
            let mut command = Command::new(program);
            command.arg("--version").stdout(Stdio::null()).stderr(Stdio::null());
            command.status().is_ok_and(|status| status.success())
        };
        if let Some(program) = named {
            return match runs(program) {
                true => Ok(Self { program: program.to_owned() }),
                false => Err(Usage(format!("{}: it cannot be started", program.display()))),
            };
        }
        let found = NAMES.iter().map(Path::new).find(|program| runs(program));
        found.map(|program| Self { program: program.to_owned() }).ok_or_else(|| {
            Usage(
                "no Chromium was found, which draws the dance: install it (Debian: apt-get install \
                 chromium), or name one with --chromium"
                    .into(),
            )
        })
    }

    /// Opens a page in a profile of its own.
    pub(super) fn open(&self, address: &str, size: Size) -> anyhow::Result<Running> {
        let profile = std::env::temp_dir().join(format!("bailando-{}", uuid::Uuid::new_v4()));
        fs::create_dir(&profile).with_context(|| profile.display().to_string())?;
        let log = profile.join("log");
        let mut command = Command::new(&self.program);
        command
            .args(["--headless=new", "--hide-scrollbars", "--no-first-run", "--mute-audio"])
            .args(["--disable-extensions", "--disable-background-networking", "--no-proxy-server"])
            // Drawn in software where there is no graphics card.
            .args(["--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"])
            .arg(format!("--user-data-dir={}", profile.display()))
            .arg(format!("--window-size={},{}", size.width, size.height));
        if is_root() {
            // Chromium does not sandbox itself as root; the page is ours.
            command.arg("--no-sandbox");
        }
        command.arg(address).stdin(Stdio::null()).stdout(Stdio::null()).stderr(File::create(&log)?);
        let child = command.spawn().with_context(|| self.program.display().to_string());
        match child {
            Ok(child) => Ok(Running { child, profile, log }),
            Err(error) => {
                let _ = fs::remove_dir_all(&profile);
                Err(error)
            }
        }
    }
}

/// Whether this process is the superuser's, whose home is readable to itself alone.
fn is_root() -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        fs::metadata("/proc/self").is_ok_and(|own| own.uid() == 0)
    }
    #[cfg(not(unix))]
    false
}

/// An open page; closed when it is dropped.
pub(super) struct Running {
    child: Child,
    profile: PathBuf,
    log: PathBuf,
}

impl Running {
    /// Waits until the browser has ended by itself, and returns its last words.
    pub(super) async fn ended(&mut self) -> String {
        loop {
            if let Ok(Some(status)) = self.child.try_wait() {
                let log = fs::read_to_string(&self.log).unwrap_or_default();
                let last = log.lines().rev().find(|line| !line.trim().is_empty());
                return format!("the browser ended with {status}: {}", last.unwrap_or("no reason"));
            }
            tokio::time::sleep(LOOK_EVERY).await;
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let stop = |child: &mut Child| -> io::Result<()> {
            child.kill()?;
            child.wait().map(drop)
        };
        // One that has ended already cannot be stopped.
        let _ = stop(&mut self.child);
        // Its helpers may still be writing; what is left lies in the folder for such files.
        for _ in 0..10 {
            if fs::remove_dir_all(&self.profile).is_ok() {
                return;
            }
            std::thread::sleep(LOOK_EVERY / 2);
        }
    }
}
