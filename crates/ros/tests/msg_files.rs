//! The wire structs against the `.msg` and `.srv` files that users build.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // Helpers of tests fail as tests do.

use std::path::Path;

use pfd_ros::messages::pfd::{
    DynamicRegion, DynamicRegions, FilePathRequest, FilePathResponse, StageTime, TrackingState,
};
use serde::Serialize;
use serde::ser::{self, Impossible, SerializeSeq, SerializeStruct, SerializeTuple};

/// `type name` of each field, as a `.msg` file has them.
fn wire_fields(message: &impl Serialize) -> Vec<String> {
    match message.serialize(Describe).unwrap() {
        Shape::Struct(_, fields) => {
            fields.into_iter().map(|(name, shape)| format!("{} {name}", shape.name())).collect()
        }
        other => panic!("not a message: {}", other.name()),
    }
}

/// The fields of a file's section (0 message or request, 1 response), constants and comments left out.
fn file_fields(path: &str, section: usize) -> Vec<String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../msgs/pfd_slam_msgs");
    let text = std::fs::read_to_string(folder.join(path)).unwrap();
    let section = text.split("---\n").nth(section).unwrap();
    let lines = section.lines().map(|line| line.split('#').next().unwrap_or_default());
    let fields = lines.filter(|line| !line.contains('='));
    fields.map(|line| line.split_whitespace().collect::<Vec<_>>().join(" ")).filter(|f| !f.is_empty()).collect()
}

#[test]
fn wire_structs_are_what_the_files_say() {
    let region = DynamicRegion::default();
    assert_eq!(wire_fields(&region), file_fields("msg/DynamicRegion.msg", 0));
    let regions = DynamicRegions { regions: vec![region], ..DynamicRegions::default() };
    assert_eq!(wire_fields(&regions), file_fields("msg/DynamicRegions.msg", 0));
    assert_eq!(wire_fields(&StageTime::default()), file_fields("msg/StageTime.msg", 0));
    let state = TrackingState { stages: vec![StageTime::default()], ..TrackingState::default() };
    assert_eq!(wire_fields(&state), file_fields("msg/TrackingState.msg", 0));
    assert_eq!(wire_fields(&FilePathRequest::default()), file_fields("srv/FilePath.srv", 0));
    assert_eq!(wire_fields(&FilePathResponse::default()), file_fields("srv/FilePath.srv", 1));
}

#[test]
fn constants_are_what_the_file_says() {
    let text = include_str!("../../../msgs/pfd_slam_msgs/msg/TrackingState.msg");
    for (name, value) in [
        ("NOT_INITIALIZED", TrackingState::NOT_INITIALIZED),
        ("OK", TrackingState::OK),
        ("LOST", TrackingState::LOST),
        ("RELOCALIZED", TrackingState::RELOCALIZED),
    ] {
        assert!(text.contains(&format!("uint8 {name}={value}")), "{name}");
    }
}

/// The type of a value as serde sees it.
enum Shape {
    Scalar(&'static str),
    Struct(&'static str, Vec<(&'static str, Shape)>),
    Array(Box<Shape>, Option<usize>),
}

impl Shape {
    fn name(&self) -> String {
        match self {
            Self::Struct(name @ ("Header" | "RegionOfInterest"), _) => {
                let package = if *name == "Header" { "std_msgs" } else { "sensor_msgs" };
                format!("{package}/{name}")
            }
            Self::Scalar(name) | Self::Struct(name, _) => (*name).to_owned(),
            Self::Array(element, length) => {
                format!("{}[{}]", element.name(), length.map_or(String::new(), |n| n.to_string()))
            }
        }
    }
}

#[derive(Debug)]
struct Unsupported(String);

impl std::fmt::Display for Unsupported {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Unsupported {}

impl ser::Error for Unsupported {
    fn custom<T: std::fmt::Display>(message: T) -> Self {
        Self(message.to_string())
    }
}

/// Turns a value into its [`Shape`].
struct Describe;

struct Fields(&'static str, Vec<(&'static str, Shape)>);

struct Elements(Vec<Shape>, bool);

impl Elements {
    fn shape(mut self) -> Shape {
        let length = self.1.then_some(self.0.len());
        Shape::Array(Box::new(self.0.pop().expect("an array must have an element to tell its type")), length)
    }
}

impl SerializeStruct for Fields {
    type Ok = Shape;
    type Error = Unsupported;
    fn serialize_field<T: Serialize + ?Sized>(&mut self, name: &'static str, value: &T) -> Result<(), Unsupported> {
        self.1.push((name, value.serialize(Describe)?));
        Ok(())
    }
    fn end(self) -> Result<Shape, Unsupported> {
        Ok(Shape::Struct(self.0, self.1))
    }
}

impl SerializeSeq for Elements {
    type Ok = Shape;
    type Error = Unsupported;
    fn serialize_element<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), Unsupported> {
        self.0.push(value.serialize(Describe)?);
        Ok(())
    }
    fn end(self) -> Result<Shape, Unsupported> {
        Ok(self.shape())
    }
}

impl SerializeTuple for Elements {
    type Ok = Shape;
    type Error = Unsupported;
    fn serialize_element<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), Unsupported> {
        SerializeSeq::serialize_element(self, value)
    }
    fn end(self) -> Result<Shape, Unsupported> {
        Ok(self.shape())
    }
}

macro_rules! scalars {
    ($($method:ident $type:ty => $name:literal),* $(,)?) => {
        $(fn $method(self, _: $type) -> Result<Shape, Unsupported> { Ok(Shape::Scalar($name)) })*
    };
}

macro_rules! unsupported {
    ($($method:ident($($argument:ty),*) -> $ok:ty),* $(,)?) => {
        $(fn $method(self, $(_: $argument),*) -> Result<$ok, Unsupported> { Err(Unsupported(stringify!($method).into())) })*
    };
}

type Never = Impossible<Shape, Unsupported>;

impl ser::Serializer for Describe {
    type Ok = Shape;
    type Error = Unsupported;
    type SerializeSeq = Elements;
    type SerializeTuple = Elements;
    type SerializeTupleStruct = Never;
    type SerializeTupleVariant = Never;
    type SerializeMap = Never;
    type SerializeStruct = Fields;
    type SerializeStructVariant = Never;

    scalars! {
        serialize_bool bool => "bool", serialize_i8 i8 => "int8", serialize_i16 i16 => "int16", serialize_i32 i32 => "int32",
        serialize_i64 i64 => "int64", serialize_u8 u8 => "uint8", serialize_u16 u16 => "uint16", serialize_u32 u32 => "uint32",
        serialize_u64 u64 => "uint64", serialize_f32 f32 => "float32", serialize_f64 f64 => "float64",
        serialize_char char => "char", serialize_str &str => "string", serialize_bytes &[u8] => "uint8[]",
    }
    unsupported! {
        serialize_none() -> Shape,
        serialize_unit() -> Shape,
        serialize_unit_struct(&'static str) -> Shape,
        serialize_unit_variant(&'static str, u32, &'static str) -> Shape,
        serialize_tuple_struct(&'static str, usize) -> Never,
        serialize_tuple_variant(&'static str, u32, &'static str, usize) -> Never,
        serialize_map(Option<usize>) -> Never,
        serialize_struct_variant(&'static str, u32, &'static str, usize) -> Never,
    }
    fn serialize_some<T: Serialize + ?Sized>(self, _: &T) -> Result<Shape, Unsupported> {
        Err(Unsupported("option".into()))
    }
    fn serialize_newtype_struct<T: Serialize + ?Sized>(self, _: &'static str, value: &T) -> Result<Shape, Unsupported> {
        value.serialize(self)
    }
    fn serialize_newtype_variant<T: Serialize + ?Sized>(
        self,
        _: &'static str,
        _: u32,
        _: &'static str,
        _: &T,
    ) -> Result<Shape, Unsupported> {
        Err(Unsupported("variant".into()))
    }
    fn serialize_seq(self, _: Option<usize>) -> Result<Elements, Unsupported> {
        Ok(Elements(Vec::new(), false))
    }
    fn serialize_tuple(self, _: usize) -> Result<Elements, Unsupported> {
        Ok(Elements(Vec::new(), true))
    }
    fn serialize_struct(self, name: &'static str, _: usize) -> Result<Fields, Unsupported> {
        Ok(Fields(name, Vec::new()))
    }
}
