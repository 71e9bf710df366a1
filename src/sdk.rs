//! The parts of the Rerun SDK that this crate is made with, in one place and under the SDK's own names.
//!
//! They are the same types as in the crate `rerun`, which is these parts and 118 crates more (servers, importers, a
//! store with queries) of which nothing is used here. [`stream::sinks`](crate::stream::sinks) uses three other parts
//! directly: the gRPC client, its messages, and the files of the web viewer.

pub use re_build_info::CrateVersion;
pub use re_byte_size::SizeBytes;
pub use re_chunk::{
    BatcherHooks, Chunk, ChunkBatcher, ChunkBatcherConfig, ChunkBuilder, ChunkComponents, ChunkId, PendingRow, RowId,
    TimeColumn, external::arrow,
};
pub use re_log_encoding::{
    DecoderApp, EncodeError, Encoder, EncodingOptions, FileSink, ToTransport, external::lz4_flex, rrd::Compression,
};
pub use re_log_types::{
    ApplicationId, ArrowMsg, BlueprintActivationCommand, EntityPath, LogMsg, SetStoreInfo, StoreId, StoreInfo,
    StoreKind, StoreSource, TimeCell, TimePoint, Timeline, TimelineName, external::re_tuid::Tuid,
};
pub use re_sdk_types::{
    AnyValues, AsComponents, ComponentDescriptor, Loggable, SerializedComponentBatch,
    archetypes::*,
    blueprint,
    components::{self, Color, Radius},
    datatypes::{self, Quaternion, Rgba32},
};

/// The version of the SDK, and of the viewer that belongs to it.
pub const VERSION: CrateVersion = CrateVersion::LOCAL;

/// The port on which a viewer listens.
pub const DEFAULT_SERVER_PORT: u16 = re_uri::DEFAULT_PROXY_PORT;

/// The address of a viewer on this machine.
pub const DEFAULT_CONNECT_URL: &str = "rerun+http://127.0.0.1:9876/proxy";
const _: () = assert!(DEFAULT_SERVER_PORT == 9876, "the port of the address");
