mod cameras;
mod pictures;
