mod bad_scenes;
mod reference;
mod scene_format;
mod recording;
