//! Where jobs, songs and results are kept, and what this process does of the work.

use std::path::{Path, PathBuf};

use bailando_jobs::{Files, JobTable, JobsError};

use crate::server::{
    callbacks::{CallbackPolicy, CallbackSecret, SecretError},
    jobs::storage::JobStorage,
};

/// Where jobs are kept unless a setting says otherwise.
const DATA_DIR: &str = "bailando-data";
/// The value of `--data-dir` that keeps them in memory.
const NONE: &str = "none";

/// What a process does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Role {
    /// Answers requests and works on jobs.
    #[default]
    All,
    /// Takes jobs for workers, and gives their results; loads no model.
    Api,
    /// Works on jobs that others take; answers probes only.
    Worker,
}

/// Where jobs are kept, and who works on them.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct StorageConfig {
    /// What this process does: `all`; `api` takes jobs and loads no model; `worker` works on them.
    /// Roles that are apart need --database, and --storage or one folder for all
    #[arg(long, env = "BAILANDO_ROLE", value_enum, default_value_t = Role::All)]
    pub role: Role,
    /// Folder of jobs, their songs and results; `none` keeps them in memory [default:
    /// ./bailando-data, or memory where that cannot be written]
    #[arg(long, env = "BAILANDO_DATA_DIR")]
    pub data_dir: Option<PathBuf>,
    /// Database of the jobs, which replicas share: postgres://USER:PASSWORD@HOST/NAME [default:
    /// SQLite in the data directory]
    #[arg(long, env = "BAILANDO_DATABASE", hide_env_values = true)]
    pub database: Option<String>,
    /// Store of songs and results, which replicas share: s3://BUCKET/PREFIX, with AWS_ENDPOINT and
    /// the other variables of AWS; or file:///FOLDER [default: the data directory]
    #[arg(long, env = "BAILANDO_STORAGE")]
    pub storage: Option<String>,
    /// Hosts that a job's `callback_url` may name; several with commas; `*.example.com` for those
    /// below a name, * for all [default: none]
    #[arg(long, env = "BAILANDO_CALLBACK_ALLOW", value_delimiter = ',')]
    pub callback_allow: Vec<String>,
    /// Secret that callbacks are signed with, as Standard Webhooks has it: 24 to 64 random bytes in
    /// base64, with or without `whsec_` before them; `openssl rand -base64 32` makes one
    #[arg(long, env = "BAILANDO_CALLBACK_SECRET", hide_env_values = true)]
    pub callback_secret: Option<CallbackSecret>,
    /// Allow callbacks over http, and to private addresses
    #[arg(
        long,
        env = "BAILANDO_CALLBACK_PRIVATE",
        value_parser = clap::builder::FalseyValueParser::new()
    )]
    pub callback_private: bool,
}

/// Settings of jobs that contradict each other, or a store that cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StorageError {
    /// The store or the database cannot be used.
    #[error(transparent)]
    Jobs(#[from] JobsError),
    /// Roles that are apart share nothing.
    #[error("--role api and --role worker need what they share: give --data-dir or --database")]
    NothingShared,
    /// Jobs in memory have no use for a database or a store alone.
    #[error(
        "--data-dir none keeps jobs in memory: leave out {given}, or name a data directory, or \
         give both --database and --storage"
    )]
    InMemory {
        /// The setting that was given.
        given: &'static str,
    },
    /// Callbacks could not be told from those of others.
    #[error("--callback-allow needs --callback-secret, which callbacks are signed with")]
    NoSecret,
    /// A secret that could be guessed, or that no receiver could decode.
    #[error(
        "--callback-secret (BAILANDO_CALLBACK_SECRET) {0}: `openssl rand -base64 32` makes a secret"
    )]
    Secret(SecretError),
}

impl StorageConfig {
    /// Checks the settings, without a look at disk or network.
    ///
    /// # Errors
    /// [`StorageError::NothingShared`], [`StorageError::InMemory`], [`StorageError::NoSecret`],
    /// [`StorageError::Secret`].
    pub fn check(&self) -> Result<(), StorageError> {
        let in_memory = self.data_dir.as_deref() == Some(Path::new(NONE));
        if in_memory {
            match (&self.database, &self.storage) {
                (Some(_), None) => return Err(StorageError::InMemory { given: "--database" }),
                (None, Some(_)) => return Err(StorageError::InMemory { given: "--storage" }),
                _ => {}
            }
        }
        let shares = self.database.is_some() || (self.data_dir.is_some() && !in_memory);
        if self.role != Role::All && !shares {
            return Err(StorageError::NothingShared);
        }
        if self.callback_allow.is_empty() {
            return Ok(());
        }
        let secret = self.callback_secret.as_ref().ok_or(StorageError::NoSecret)?;
        secret.check().map_err(StorageError::Secret)
    }

    /// Opens what the settings name. A folder of the settings that cannot be written to is an
    /// error; where the default one cannot, jobs are kept in memory, and the log says so.
    ///
    /// # Errors
    /// [`StorageError`].
    pub async fn open(&self) -> Result<JobStorage, StorageError> {
        self.check()?;
        if self.data_dir.as_deref() == Some(Path::new(NONE)) && self.database.is_none() {
            return Ok(JobStorage::default());
        }
        let folder = self.data_dir.as_deref().unwrap_or(Path::new(DATA_DIR));
        let files = match &self.storage {
            Some(url) => Files::at_url(url)?,
            None => match Files::in_folder(folder) {
                Err(error) if self.data_dir.is_none() && self.database.is_none() => {
                    tracing::warn!(
                        %error,
                        "jobs are kept in memory, and end with this process: give --data-dir"
                    );
                    return Ok(JobStorage::default());
                }
                files => files?,
            },
        };
        let table = match &self.database {
            Some(url) => JobTable::at_url(url)?,
            None => {
                std::fs::create_dir_all(folder).map_err(|source| {
                    let folder = folder.to_path_buf();
                    JobsError::Folder { folder, source }
                })?;
                let table = JobTable::in_file(&folder.join("jobs.sqlite"));
                // A file that is no database is seen now; a server elsewhere may come later.
                table.open().await?;
                table
            }
        };
        Ok(JobStorage::durable(table, files))
    }

    /// Who may be called back, and how.
    #[must_use]
    pub fn callbacks(&self) -> CallbackPolicy {
        CallbackPolicy {
            allow: self.callback_allow.clone(),
            secret: self.callback_secret.clone().unwrap_or_default(),
            private: self.callback_private,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(folder: &Path) -> StorageConfig {
        StorageConfig { data_dir: Some(folder.to_path_buf()), ..StorageConfig::default() }
    }

    #[tokio::test]
    async fn a_folder_that_was_asked_for_is_used_or_refused() {
        let folder = tempfile::tempdir().unwrap();
        let opened = config(&folder.path().join("new")).open().await.unwrap();
        assert!(opened.durable && folder.path().join("new/jobs.sqlite").exists());
        assert!(!config(Path::new("none")).open().await.unwrap().durable);
        let refused = config(Path::new("/proc/nothing")).open().await.unwrap_err().to_string();
        assert!(refused.contains("/proc/nothing"), "{refused}");
    }

    #[test]
    fn settings_that_contradict_each_other_are_refused() {
        let apart = StorageConfig { role: Role::Worker, ..StorageConfig::default() };
        assert!(matches!(apart.check(), Err(StorageError::NothingShared)));
        let none = config(Path::new("none"));
        let [url, store] = ["sqlite://jobs.sqlite", "s3://songs"].map(|url| Some(url.to_owned()));
        let database = StorageConfig { database: url.clone(), ..none.clone() };
        let said = database.check().unwrap_err().to_string();
        assert!(said.contains("leave out --database,"), "{said}");
        let storage = StorageConfig { storage: store.clone(), ..none.clone() };
        let said = storage.check().unwrap_err().to_string();
        assert!(said.contains("leave out --storage,"), "{said}");
        // Nothing is left that would be kept in a folder.
        let both = StorageConfig { database: url, storage: store, ..none };
        assert!(both.check().is_ok());
        let unsigned =
            StorageConfig { callback_allow: vec!["*".to_owned()], ..StorageConfig::default() };
        assert!(matches!(unsigned.check(), Err(StorageError::NoSecret)));
        let guessed = StorageConfig { callback_secret: "secret".parse().ok(), ..unsigned };
        let refused = guessed.check().unwrap_err().to_string();
        assert!(refused.contains("openssl rand -base64 32"), "{refused}");
        assert!(!refused.contains("secret\""), "{refused}");
    }
}
