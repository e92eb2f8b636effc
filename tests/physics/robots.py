"""Robots whose masses and inertias are those of the textbooks."""

BRICK = """<robot name="brick">
  <link name="brick">
    <inertial>
      <mass value="2"/>
      <inertia ixx="0.0216666666666667" iyy="0.0166666666666667" izz="0.00833333333333333" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <collision><geometry><box size="0.1 0.2 0.3"/></geometry></collision>
  </link>
</robot>
"""
"""A homogeneous box of 2 kg, 10 x 20 x 30 cm."""

PENDULUM = """<robot name="pendulum">
  <link name="stand"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="rod">
    <inertial>
      <origin xyz="0 0 -0.5"/><mass value="0.3"/>
      <inertia ixx="0.025" iyy="0.025" izz="1e-6" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="hinge" type="continuous"><parent link="stand"/><child link="rod"/><axis xyz="0 1 0"/></joint>
</robot>
"""
"""A thin rod of 1 m and 0.3 kg, which hangs from its end."""

BALL_PENDULUM = PENDULUM.replace('type="continuous"', 'type="spherical"').replace("hinge", "ball")
"""The same rod on a ball joint."""

ARM = """<robot name="arm">
  <link name="stand"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="arm">
    <inertial><origin xyz="0.25 0 0"/><mass value="1"/><inertia ixx="0.01" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="hinge" type="continuous">
    <parent link="stand"/><child link="arm"/><axis xyz="0 0 1"/><limit effort="1000" velocity="100"/>
  </joint>
</robot>
"""
"""A link on a vertical hinge."""

CART = """<robot name="cart">
  <link name="rail"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="cart"><inertial><mass value="1.5"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="slider" type="prismatic">
    <parent link="rail"/><child link="cart"/><axis xyz="1 0 0"/><limit lower="-100" upper="100" effort="1000000" velocity="10000"/>
  </joint>
</robot>
"""
"""A mass of 1.5 kg on a rail."""
