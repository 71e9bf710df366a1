//! The Rerun SDK, in one place: every other module takes its types from here.

pub use rerun::{
    ApplicationId, AsComponents, ComponentDescriptor, ComponentIdentifier, EntityPath, Loggable, RecordingStream,
    RecordingStreamBuilder, RecordingStreamResult, SerializedComponentBatch, SizeBytes, StoreId, StoreKind, TimeCell,
    TimePoint, Timeline, TimelineName,
    components::{self, Color, Radius},
    datatypes::{self, Quaternion, Rgba32},
    external::{
        re_build_info::CrateVersion,
        re_chunk_store::external::re_chunk::{
            Chunk, ChunkBuilder, ChunkComponents, ChunkId, RowId, TimeColumn, external::arrow,
        },
        re_grpc_client,
        re_log_encoding::{
            DecoderApp, EncodeError, Encoder, EncodingOptions, ToTransport, external::lz4_flex, rrd::Compression,
        },
        re_log_types::{
            ArrowMsg, BlueprintActivationCommand, LogMsg, SetStoreInfo, StoreInfo, StoreSource, external::re_tuid::Tuid,
        },
        re_sdk_types::{AnyValues, archetypes::*, blueprint},
        re_uri,
    },
};

/// The version of the SDK, and of the viewer that belongs to it.
pub const VERSION: CrateVersion = CrateVersion::LOCAL;

/// The port on which a viewer listens.
pub const DEFAULT_SERVER_PORT: u16 = rerun::DEFAULT_SERVER_PORT;

/// The address of a viewer on this machine.
pub const DEFAULT_CONNECT_URL: &str = rerun::DEFAULT_CONNECT_URL;
