from controller import Robot


class CSVRobot(Robot):
    def __init__(self, emitter_name="emitter", receiver_name="receiver", timestep=None):
        super().__init__()
        self.timestep = int(self.getBasicTimeStep() if timestep is None else timestep)
        self.emitter, self.receiver = self.initialize_comms(emitter_name, receiver_name)

    def initialize_comms(self, emitter_name, receiver_name):
        receiver = self.getDevice(receiver_name)
        receiver.enable(self.timestep)
        return self.getDevice(emitter_name), receiver

    def handle_emitter(self):
        data = self.create_message()
        self.emitter.send((data if isinstance(data, str) else ",".join(map(str, data))).encode())

    def handle_receiver(self):
        if self.receiver.getQueueLength() > 0:
            self.use_message_data(self.receiver.getString().split(","))
            self.receiver.nextPacket()

    def run(self):
        while self.step(self.timestep) != -1:
            self.handle_receiver()
            self.handle_emitter()
