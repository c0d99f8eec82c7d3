//! What can go wrong with jobs and their files.

/// The reason why the table of jobs or the store of files did not do as asked.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum JobsError {
    /// The database is down, full, locked for too long, or not writable.
    #[error("the database of jobs failed: {0}")]
    Database(#[from] sqlx::Error),
    /// The database has tables of a later release.
    #[error(
        "the database of jobs has schema {found}, which a later release wrote: this one knows up \
         to {known}"
    )]
    Schema {
        /// Version in the database.
        found: i64,
        /// Latest version that this release knows.
        known: i64,
    },
    /// A row does not hold what this release writes there.
    #[error("the record of job {id} cannot be read: {problem}")]
    Record {
        /// The job.
        id: String,
        /// What is wrong with it.
        problem: String,
    },
    /// The store of files is down, full or not writable, or its bucket is gone.
    #[error("the store of songs and results failed: {0}")]
    Store(#[from] object_store::Error),
    /// A file is not there.
    #[error("{name} is not in the store of songs and results")]
    NoFile {
        /// Its name in the store.
        name: String,
    },
    /// The folder cannot be made or written to.
    #[error("the data folder {} cannot be used: {source}", folder.display())]
    Folder {
        /// The folder.
        folder: std::path::PathBuf,
        /// What the operating system says.
        source: std::io::Error,
    },
    /// The address names no database or store that is supported.
    #[error("{address:?} cannot be used: {problem}")]
    Address {
        /// As it was given, without its password.
        address: String,
        /// What is wrong, and what is accepted.
        problem: String,
    },
}

impl JobsError {
    /// Whether SQLite found its file locked by another connection (`SQLITE_BUSY`, which is the
    /// lowest byte of its extended codes).
    pub(crate) fn is_locked(&self) -> bool {
        const SQLITE_BUSY: u32 = 5;
        let Self::Database(sqlx::Error::Database(error)) = self else { return false };
        let code = error.code().and_then(|code| code.parse::<u32>().ok());
        code.is_some_and(|code| code & 0xff == SQLITE_BUSY)
    }

    /// Whether a row was given that does not hold what this release reads there, as opposed to a
    /// database that failed.
    pub(crate) fn is_unreadable(&self) -> bool {
        let Self::Database(error) = self else { return matches!(self, Self::Record { .. }) };
        matches!(
            error,
            sqlx::Error::ColumnDecode { .. }
                | sqlx::Error::ColumnNotFound(_)
                | sqlx::Error::Decode(_)
        )
    }

    /// Whether a file or a record is missing or broken, as opposed to a fault that passes.
    #[must_use]
    pub fn is_lasting(&self) -> bool {
        matches!(self, Self::NoFile { .. } | Self::Record { .. } | Self::Schema { .. })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_database_that_fails_says_nothing_about_a_row() {
        let name = String::new;
        assert!(JobsError::Record { id: name(), problem: name() }.is_unreadable());
        let decode = sqlx::Error::ColumnDecode { index: name(), source: "no text".into() };
        for unreadable in [decode, sqlx::Error::ColumnNotFound(name())] {
            assert!(JobsError::Database(unreadable).is_unreadable());
        }
        let broken_off = std::io::Error::from(std::io::ErrorKind::ConnectionReset);
        let broken_off = sqlx::Error::Io(broken_off);
        for passes in [broken_off, sqlx::Error::PoolTimedOut, sqlx::Error::WorkerCrashed] {
            assert!(!JobsError::Database(passes).is_unreadable());
        }
    }
}
