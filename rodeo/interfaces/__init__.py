"""The organization as ROS 2 interfaces: `rodeo_msgs`, made from the commands, the queries and their models.

naming      what ROS calls a field, a message and a service
fields      the fields of a message, from those of a model
problem     an error as nodes get it
actions     what the goals, results and feedback of actions hold
recorder    what a mind asks of its robot's recorder
package     every message, service and action, their texts, and their types in `rodeo.ros2`
convert     values of models to messages, and back
ros1        the same in the grammar of ROS 1, and the table of its relay
generate    writes their files and the page of reference
"""
