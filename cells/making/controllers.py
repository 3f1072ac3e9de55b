"""What a program must know of each maker's controller: YAML of a cell's ``controller``."""

SAME_AXES = """\
  joint_map: {sign: [1, 1, 1, 1, 1, 1], offset_deg: [0, 0, 0, 0, 0, 0]}   # the URDF counts as the controller
  root: {xyz_mm: [0, 0, 0], rpy_deg: [0, 0, 0]}
  flange: {xyz_mm: [0, 0, 0], rpy_deg: [0, 0, 0]}"""
KUKA = f"""\
  post: krl   # tool and base stand in the program itself: no numbers
{SAME_AXES}"""
ABB = f"""\
  post: rapid
{SAME_AXES}"""
UR = f"""\
  post: urscript   # an assumption: README.md
{SAME_AXES}"""
FANUC = """\
  post: fanuc
  joint_map:   # J2 forwards, J3 from the horizontal whatever J2 does, J4 and J6 turn the other way: README.md
    sign: [1, -1, 1, -1, 1, -1]
    offset_deg: [0, 0, 0, 0, 0, 0]
    coupling: {j3: {j2: -1}}
  root: {xyz_mm: [0, 0, 900], rpy_deg: [0, 0, 0]}   # on axis 1 at the height of axis 2
  flange: {xyz_mm: [0, 0, 0], rpy_deg: [0, 0, 180]}
  tool_number: 1
  base_number: 1
  nonflip_j5: negative"""
