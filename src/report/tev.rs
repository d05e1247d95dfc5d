//! Images for a running tev, in the messages of its TCP protocol.
//!
//! A message is its length in bytes (itself included), the sort of the message, and its fields: little endian, texts
//! ended by a zero. An image is created under a name (in place of an earlier one), then its channels are filled one by
//! one. After the protocol as tev's README describes it.

use crate::formats::{self, Content, Limits};
use crate::image::display;
use crate::image::raster::Image;

/// Where tev listens unless it is told otherwise.
pub const ADDRESS: &str = "127.0.0.1:14158";

const UPDATE_IMAGE: u8 = 3;
const CREATE_IMAGE: u8 = 4;

/// The messages that show an image file under a name; none if it is no image.
pub fn messages(name: &str, file: &[u8]) -> Option<Vec<Vec<u8>>> {
    let image = match formats::read(file, name, &Limits::default()).ok()?.content {
        Content::Linear(image) => image,
        Content::Display(picture) => display::decoded(&picture),
    };
    let size = [i32::try_from(image.color.width()).ok()?, i32::try_from(image.color.height()).ok()?];
    let channels = channels(&image);
    let create = Message::new(CREATE_IMAGE).text(name).numbers(&size).numbers(&[channels.len() as i32]);
    let create = channels.iter().fold(create, |message, (channel, _)| message.text(channel));
    let update = |(channel, values): (&str, Vec<f32>)| {
        let message = Message::new(UPDATE_IMAGE).text(name).text(channel).numbers(&[0, 0]).numbers(&size);
        message.floats(&values).finish()
    };
    Some(std::iter::once(create.finish()).chain(channels.into_iter().map(update)).collect())
}

fn channels(image: &Image) -> Vec<(&'static str, Vec<f32>)> {
    let color = |channel: usize| image.color.pixels().iter().map(|pixel| pixel[channel]).collect();
    let mut channels: Vec<(&'static str, Vec<f32>)> = vec![("R", color(0)), ("G", color(1)), ("B", color(2))];
    channels.extend(image.alpha.as_ref().map(|alpha| ("A", alpha.values.clone())));
    channels
}

/// A message that grows field by field.
struct Message(Vec<u8>);

impl Message {
    /// Room for the length, the sort, and that the image need not come to the front.
    fn new(sort: u8) -> Self {
        Self(vec![0, 0, 0, 0, sort, 0])
    }

    /// A zero would end it early; no name that we publish has one.
    fn text(mut self, text: &str) -> Self {
        self.0.extend(text.bytes().filter(|byte| *byte != 0));
        self.0.push(0);
        self
    }

    fn numbers(mut self, values: &[i32]) -> Self {
        self.0.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        self
    }

    fn floats(mut self, values: &[f32]) -> Self {
        self.0.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        self
    }

    fn finish(mut self) -> Vec<u8> {
        let length = (self.0.len() as u32).to_le_bytes();
        self.0[..4].copy_from_slice(&length);
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::raster::Raster;

    #[test]
    fn an_image_is_created_and_its_channels_are_filled() {
        let image = Image::opaque(Raster::new(2, 1, vec![[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]));
        let (file, _) = formats::encode(&image, "pfm", &[]).unwrap();
        let messages = messages("a/b.pfm", &file).unwrap();
        assert_eq!(messages[0], *b"\x20\0\0\0\x04\0a/b.pfm\0\x02\0\0\0\x01\0\0\0\x03\0\0\0R\0G\0B\0");
        assert_eq!(messages.len(), 4);
        let green = &messages[2];
        assert_eq!(u32::from_le_bytes(green[..4].try_into().unwrap()) as usize, green.len());
        assert_eq!(green[4..16], *b"\x03\0a/b.pfm\0G\0");
        assert_eq!(green[green.len() - 8..], [2.0_f32.to_le_bytes(), 5.0_f32.to_le_bytes()].concat());
    }

    #[test]
    fn what_is_no_image_is_not_sent() {
        assert!(messages("a.csv", b"n,error\n").is_none());
    }
}
