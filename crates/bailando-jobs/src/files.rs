//! Songs and results: in a folder, in an S3-compatible store, or in memory.

use std::{fs, ops::Range, path::Path as FilePath, sync::Arc, time::Duration};

use bytes::{Bytes, BytesMut};
use futures_util::{Stream, StreamExt, TryStreamExt};
use object_store::{
    GetOptions, GetRange, ObjectStore, ObjectStoreExt, RetryConfig, aws::AmazonS3Builder,
    buffered::BufWriter, local::LocalFileSystem, memory::InMemory, path::Path, prefix::PrefixStore,
};
use sync_wrapper::SyncWrapper;
use tokio::{io::AsyncWriteExt, runtime::Handle};

use super::{JobsError, database::without_password};

/// Bytes that are held of a file while it is written; S3 takes parts of 5 MiB at least.
const PART: usize = 5 * 1024 * 1024;
/// Bytes of a whole file that are handed to the store at once.
const PIECE: usize = 1 << 20;
/// Parts that are on their way at the same time.
const PARTS_AT_ONCE: usize = 2;
/// How long a store that does not answer is asked again, well below the time of a request: its
/// client is then told when to try again, and a job is put back.
const PATIENCE: Duration = Duration::from_secs(5);

/// A store of files, each written whole or not at all. Clones share it.
#[derive(Clone, Debug)]
pub struct Files {
    store: Arc<dyn ObjectStore>,
    shared: bool,
    folder: Option<Arc<FilePath>>,
}

impl Files {
    /// A store in memory, which ends with its last clone.
    #[must_use]
    pub fn in_memory() -> Self {
        Self { store: Arc::new(InMemory::new()), shared: false, folder: None }
    }

    /// A store in a folder, which is made if it is not there. What was written survives a loss of
    /// power.
    ///
    /// # Errors
    /// [`JobsError::Folder`] if nothing can be written there.
    pub fn in_folder(folder: &FilePath) -> Result<Self, JobsError> {
        let refuse = |source| JobsError::Folder { folder: folder.to_path_buf(), source };
        fs::create_dir_all(folder).map_err(refuse)?;
        let probe = folder.join(format!(".probe-{}", std::process::id()));
        fs::write(&probe, b"").and_then(|()| fs::remove_file(&probe)).map_err(refuse)?;
        let store = LocalFileSystem::new_with_prefix(folder)?;
        // Every job has a folder, which goes with the last of its files.
        let store = store.with_fsync(true).with_automatic_cleanup(true);
        Ok(Self { store: Arc::new(store), shared: false, folder: Some(folder.into()) })
    }

    /// The store of a URL: `s3://bucket/prefix`, with key, region and endpoint from the variables
    /// `AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`, `AWS_REGION`, `AWS_ENDPOINT` ..; or a folder
    /// as `file:///path`.
    ///
    /// # Errors
    /// [`JobsError::Address`], [`JobsError::Folder`].
    pub fn at_url(url: &str) -> Result<Self, JobsError> {
        if let Some(folder) = url.strip_prefix("file://") {
            return Ok(Self { shared: true, ..Self::in_folder(FilePath::new(folder))? });
        }
        let refuse =
            |problem: String| JobsError::Address { address: without_password(url), problem };
        let Some(place) = url.strip_prefix("s3://") else {
            return Err(refuse("give s3://BUCKET/PREFIX or file:///FOLDER".to_owned()));
        };
        let (bucket, prefix) = place.split_once('/').unwrap_or((place, ""));
        // One that was chosen before stays.
        drop(rustls::crypto::ring::default_provider().install_default());
        let retry = RetryConfig { retry_timeout: PATIENCE, ..RetryConfig::default() };
        let store = AmazonS3Builder::from_env().with_bucket_name(bucket).with_retry(retry).build();
        let store = store.map_err(|error| refuse(error.to_string()))?;
        let prefix = Path::parse(prefix).map_err(|error| refuse(error.to_string()))?;
        Ok(Self { store: Arc::new(PrefixStore::new(store, prefix)), shared: true, folder: None })
    }

    /// Whether replicas on other machines can share the store.
    #[must_use]
    pub fn is_shared(&self) -> bool {
        self.shared
    }

    /// Begins to write a file. Nothing of it is seen before [`FileWriter::finish`].
    #[must_use]
    pub fn write(&self, name: &str) -> FileWriter {
        let writer = BufWriter::with_capacity(Arc::clone(&self.store), Path::from(name), PART);
        FileWriter {
            writer: Some(SyncWrapper::new(writer.with_max_concurrency(PARTS_AT_ONCE))),
            bytes: 0,
        }
    }

    /// Writes a whole file.
    ///
    /// # Errors
    /// [`JobsError::Store`].
    pub async fn put(&self, name: &str, mut bytes: Bytes) -> Result<u64, JobsError> {
        let mut writer = self.write(name);
        // All at once would begin all parts at the same time.
        while !bytes.is_empty() {
            writer.push(bytes.split_to(PIECE.min(bytes.len()))).await?;
        }
        writer.finish().await
    }

    /// Reads a file, or a part of it, piece by piece; with the size of the whole file.
    ///
    /// # Errors
    /// [`JobsError::NoFile`], [`JobsError::Store`]; of the stream, [`JobsError::Store`].
    pub async fn read(
        &self,
        name: &str,
        range: Option<Range<u64>>,
    ) -> Result<(u64, impl Stream<Item = Result<Bytes, JobsError>> + Send + use<>), JobsError> {
        let options = GetOptions { range: range.map(GetRange::Bounded), ..GetOptions::default() };
        let file = self.store.get_opts(&Path::from(name), options).await;
        let file = file.map_err(|error| missing(error, name))?;
        Ok((file.meta.size, file.into_stream().map_err(JobsError::from)))
    }

    /// Reads a whole file of a known size into memory.
    ///
    /// # Errors
    /// As [`Files::read`].
    pub async fn read_whole(&self, name: &str) -> Result<Bytes, JobsError> {
        let (size, mut pieces) = self.read(name, None).await?;
        let mut bytes = BytesMut::with_capacity(usize::try_from(size).unwrap_or(0));
        while let Some(piece) = pieces.next().await {
            bytes.extend_from_slice(&piece?);
        }
        Ok(bytes.freeze())
    }

    /// Deletes a file, if it is there.
    ///
    /// # Errors
    /// [`JobsError::Store`].
    pub async fn delete(&self, name: &str) -> Result<(), JobsError> {
        match self.store.delete(&Path::from(name)).await {
            Ok(()) | Err(object_store::Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }

    /// Copies a file within the store.
    ///
    /// # Errors
    /// As [`Files::read`].
    pub async fn copy(&self, from: &str, to: &str) -> Result<(), JobsError> {
        let copied = self.store.copy(&Path::from(from), &Path::from(to)).await;
        copied.map_err(|error| missing(error, from))
    }

    /// Copies the files of a folder of the store to another, but for those named `except`; their
    /// number.
    ///
    /// # Errors
    /// As [`Files::read`].
    pub async fn copy_below(&self, from: &str, to: &str, except: &str) -> Result<usize, JobsError> {
        let mut names = self.store.list(Some(&Path::from(from)));
        let mut copied = 0;
        while let Some(file) = names.try_next().await? {
            let name = file.location.filename().unwrap_or_default();
            if name != except {
                self.copy(file.location.as_ref(), &format!("{to}/{name}")).await?;
                copied += 1;
            }
        }
        Ok(copied)
    }

    /// Deletes all files below a folder of the store; their number.
    ///
    /// # Errors
    /// [`JobsError::Store`].
    pub async fn delete_below(&self, folder: &str) -> Result<usize, JobsError> {
        let files = self.store.list(Some(&Path::from(folder)));
        let mut names = files.map_ok(|file| file.location).boxed();
        let mut deleted = 0;
        while let Some(name) = names.try_next().await? {
            self.delete(name.as_ref()).await?;
            deleted += 1;
        }
        Ok(deleted)
    }

    /// Names of files below `folder` that were last written before so long.
    ///
    /// # Errors
    /// [`JobsError::Store`]; of the stream too.
    pub fn older_than(
        &self,
        folder: &str,
        age: Duration,
    ) -> impl Stream<Item = Result<String, JobsError>> + Send + use<> {
        let files = self.store.list(Some(&Path::from(folder)));
        let now = super::now();
        let age = i64::try_from(age.as_millis()).unwrap_or(i64::MAX);
        files.map_err(JobsError::from).try_filter_map(move |file| {
            let old = now.saturating_sub(file.last_modified.timestamp_millis()) > age;
            std::future::ready(Ok(old.then(|| file.location.to_string())))
        })
    }

    /// Deletes what a killed process has left of files that it was writing to a folder, and empty
    /// folders; blocks.
    pub fn delete_fragments(&self, age: Duration) {
        let mut folders: Vec<_> = self.folder.iter().map(|folder| folder.to_path_buf()).collect();
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(&folder).into_iter().flatten().flatten() {
                let Ok(about) = entry.metadata() else { continue };
                let name = entry.file_name();
                let is_fragment =
                    name.to_string_lossy().rsplit_once('#').is_some_and(|(_, end)| {
                        !end.is_empty() && end.bytes().all(|byte| byte.is_ascii_digit())
                    });
                let old = about
                    .modified()
                    .is_ok_and(|time| time.elapsed().is_ok_and(|elapsed| elapsed > age));
                if about.is_dir() {
                    folders.push(entry.path());
                    if old {
                        // Of a file that was given up; one that is not empty stays.
                        drop(fs::remove_dir(entry.path()));
                    }
                } else if is_fragment && old {
                    drop(fs::remove_file(entry.path()));
                }
            }
        }
    }
}

pub(crate) fn missing(error: object_store::Error, name: &str) -> JobsError {
    match error {
        // S3 answers 404 to both, but a bucket may come back with all that was in it.
        object_store::Error::NotFound { ref source, .. }
            if !source.to_string().contains("NoSuchBucket") =>
        {
            JobsError::NoFile { name: name.to_owned() }
        }
        other => other.into(),
    }
}

/// A file that is being written, of which three parts of 5 MiB at most are in memory. Dropped
/// before it is finished, it is not there.
#[derive(Debug)]
pub struct FileWriter {
    /// Until it is finished.
    writer: Option<SyncWrapper<BufWriter>>,
    bytes: u64,
}

impl FileWriter {
    /// Adds a piece; waits where the store is slower than its writer.
    ///
    /// # Errors
    /// [`JobsError::Store`].
    pub async fn push(&mut self, piece: Bytes) -> Result<(), JobsError> {
        self.bytes += piece.len() as u64;
        #[expect(clippy::expect_used, reason = "only what ends the writer takes it")]
        let writer = self.writer.as_mut().expect("the file is being written");
        Ok(writer.get_mut().put(piece).await?)
    }

    /// Completes the file; its size in bytes.
    ///
    /// # Errors
    /// [`JobsError::Store`].
    pub async fn finish(mut self) -> Result<u64, JobsError> {
        if let Some(writer) = self.writer.take() {
            writer.into_inner().shutdown().await.map_err(store_error)?;
        }
        Ok(self.bytes)
    }
}

impl Drop for FileWriter {
    fn drop(&mut self) {
        // A store keeps the parts of a file until it is told that the rest does not come. What is
        // left even so is deleted by its age.
        let begun = self.bytes >= PART as u64;
        if let (Some(writer), true, Ok(runtime)) =
            (self.writer.take(), begun, Handle::try_current())
        {
            runtime.spawn(async move { drop(writer.into_inner().abort().await) });
        }
    }
}

fn store_error(error: std::io::Error) -> JobsError {
    JobsError::Store(object_store::Error::Generic { store: "files", source: Box::new(error) })
}
