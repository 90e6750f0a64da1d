.class public final Ldressi/Session;
.super Ljava/lang/Object;

# interfaces
.implements Ljava/lang/AutoCloseable;


# instance fields
.field private handle:J

.field private final open:Ljava/util/concurrent/locks/ReadWriteLock;


# direct methods
.method static constructor <clinit>()V
    .registers 1

    const-string v0, "dressi"

    invoke-static {v0}, Ljava/lang/System;->loadLibrary(Ljava/lang/String;)V

    return-void
.end method

.method private constructor <init>(J)V
    .registers 4

    invoke-direct {p0}, Ljava/lang/Object;-><init>()V

    new-instance v0, Ljava/util/concurrent/locks/ReentrantReadWriteLock;

    invoke-direct {v0}, Ljava/util/concurrent/locks/ReentrantReadWriteLock;-><init>()V

    iput-object v0, p0, Ldressi/Session;->open:Ljava/util/concurrent/locks/ReadWriteLock;

    iput-wide p1, p0, Ldressi/Session;->handle:J

    return-void
.end method

.method private begin()J
    .registers 5

    iget-object v0, p0, Ldressi/Session;->open:Ljava/util/concurrent/locks/ReadWriteLock;

    invoke-interface {v0}, Ljava/util/concurrent/locks/ReadWriteLock;->readLock()Ljava/util/concurrent/locks/Lock;

    move-result-object v0

    invoke-interface {v0}, Ljava/util/concurrent/locks/Lock;->lock()V

    iget-wide v0, p0, Ldressi/Session;->handle:J

    const-wide/16 v2, 0x0

    cmp-long v0, v0, v2

    if-eqz v0, :cond_14

    iget-wide v0, p0, Ldressi/Session;->handle:J

    return-wide v0

    :cond_14
    iget-object v0, p0, Ldressi/Session;->open:Ljava/util/concurrent/locks/ReadWriteLock;

    invoke-interface {v0}, Ljava/util/concurrent/locks/ReadWriteLock;->readLock()Ljava/util/concurrent/locks/Lock;

    move-result-object v0

    invoke-interface {v0}, Ljava/util/concurrent/locks/Lock;->unlock()V

    new-instance v0, Ljava/lang/IllegalStateException;

    const-string v1, "the session is closed"

    invoke-direct {v0, v1}, Ljava/lang/IllegalStateException;-><init>(Ljava/lang/String;)V

    throw v0
.end method

.method private static native checkpoint(JLjava/lang/String;)V
.end method

.method private static native close(J)V
.end method

.method private end()V
    .registers 2

    iget-object v0, p0, Ldressi/Session;->open:Ljava/util/concurrent/locks/ReadWriteLock;

    invoke-interface {v0}, Ljava/util/concurrent/locks/ReadWriteLock;->readLock()Ljava/util/concurrent/locks/Lock;

    move-result-object v0

    invoke-interface {v0}, Ljava/util/concurrent/locks/Lock;->unlock()V

    return-void
.end method

.method private static native get(JLjava/lang/String;Ljava/nio/ByteBuffer;II)V
.end method

.method private static native loss(J)F
.end method

.method private static native open(Ljava/lang/String;Ljava/nio/ByteBuffer;IIJLjava/lang/String;Ljava/lang/String;Ljava/lang/String;)J
.end method

.method public static open(Ljava/lang/String;Ldressi/Device;Ljava/lang/String;Ljava/lang/String;Ljava/lang/String;)Ldressi/Session;
    .registers 15

    const/4 v2, 0x0

    new-instance v9, Ldressi/Session;

    const/4 v1, 0x0

    if-nez p1, :cond_15

    const-wide/16 v4, 0x0

    :goto_8
    move-object v0, p0

    move v3, v2

    move-object v6, p2

    move-object v7, p3

    move-object v8, p4

    invoke-static/range {v0 .. v8}, Ldressi/Session;->open(Ljava/lang/String;Ljava/nio/ByteBuffer;IIJLjava/lang/String;Ljava/lang/String;Ljava/lang/String;)J

    move-result-wide v0

    invoke-direct {v9, v0, v1}, Ldressi/Session;-><init>(J)V

    return-object v9

    :cond_15
    invoke-virtual {p1}, Ldressi/Device;->handle()J

    move-result-wide v4

    goto :goto_8
.end method

.method public static open(Ljava/nio/ByteBuffer;Ldressi/Device;Ljava/lang/String;Ljava/lang/String;Ljava/lang/String;)Ldressi/Session;
    .registers 15

    if-nez p1, :cond_1b

    const-wide/16 v4, 0x0

    :goto_4
    new-instance v9, Ldressi/Session;

    const/4 v0, 0x0

    invoke-virtual {p0}, Ljava/nio/ByteBuffer;->position()I

    move-result v2

    invoke-virtual {p0}, Ljava/nio/ByteBuffer;->remaining()I

    move-result v3

    move-object v1, p0

    move-object v6, p2

    move-object v7, p3

    move-object v8, p4

    invoke-static/range {v0 .. v8}, Ldressi/Session;->open(Ljava/lang/String;Ljava/nio/ByteBuffer;IIJLjava/lang/String;Ljava/lang/String;Ljava/lang/String;)J

    move-result-wide v0

    invoke-direct {v9, v0, v1}, Ldressi/Session;-><init>(J)V

    return-object v9

    :cond_1b
    invoke-virtual {p1}, Ldressi/Device;->handle()J

    move-result-wide v4

    goto :goto_4
.end method

.method private static native phase(JI[J)Ljava/lang/String;
.end method

.method private static native report(J)Ljava/lang/String;
.end method

.method private static native restore(JLjava/lang/String;)V
.end method

.method private static native set(JLjava/lang/String;Ljava/nio/ByteBuffer;II)V
.end method

.method private static native step(JJLjava/lang/String;DLjava/util/concurrent/atomic/AtomicBoolean;)J
.end method

.method private static native value(JI[Ljava/lang/String;)[I
.end method


# virtual methods
.method public checkpoint(Ljava/lang/String;)V
    .registers 4

    invoke-direct {p0}, Ldressi/Session;->begin()J

    move-result-wide v0

    :try_start_4
    invoke-static {v0, v1, p1}, Ldressi/Session;->checkpoint(JLjava/lang/String;)V
    :try_end_7
    .catchall {:try_start_4 .. :try_end_7} :catchall_b

    invoke-direct {p0}, Ldressi/Session;->end()V

    return-void

    :catchall_b
    move-exception v0

    invoke-direct {p0}, Ldressi/Session;->end()V

    throw v0
.end method

.method public close()V
    .registers 7

    const-wide/16 v4, 0x0

    iget-object v0, p0, Ldressi/Session;->open:Ljava/util/concurrent/locks/ReadWriteLock;

    invoke-interface {v0}, Ljava/util/concurrent/locks/ReadWriteLock;->writeLock()Ljava/util/concurrent/locks/Lock;

    move-result-object v0

    invoke-interface {v0}, Ljava/util/concurrent/locks/Lock;->lock()V

    :try_start_b
    iget-wide v0, p0, Ldressi/Session;->handle:J

    const-wide/16 v2, 0x0

    iput-wide v2, p0, Ldressi/Session;->handle:J

    cmp-long v2, v0, v4

    if-eqz v2, :cond_18

    invoke-static {v0, v1}, Ldressi/Session;->close(J)V
    :try_end_18
    .catchall {:try_start_b .. :try_end_18} :catchall_22

    :cond_18
    iget-object v0, p0, Ldressi/Session;->open:Ljava/util/concurrent/locks/ReadWriteLock;

    invoke-interface {v0}, Ljava/util/concurrent/locks/ReadWriteLock;->writeLock()Ljava/util/concurrent/locks/Lock;

    move-result-object v0

    invoke-interface {v0}, Ljava/util/concurrent/locks/Lock;->unlock()V

    return-void

    :catchall_22
    move-exception v0

    iget-object v1, p0, Ldressi/Session;->open:Ljava/util/concurrent/locks/ReadWriteLock;

    invoke-interface {v1}, Ljava/util/concurrent/locks/ReadWriteLock;->writeLock()Ljava/util/concurrent/locks/Lock;

    move-result-object v1

    invoke-interface {v1}, Ljava/util/concurrent/locks/Lock;->unlock()V

    throw v0
.end method

.method public find(Ljava/lang/String;)Ldressi/Value;
    .registers 5

    invoke-virtual {p0}, Ldressi/Session;->values()Ljava/util/List;

    move-result-object v0

    invoke-interface {v0}, Ljava/util/List;->iterator()Ljava/util/Iterator;

    move-result-object v1

    :cond_8
    invoke-interface {v1}, Ljava/util/Iterator;->hasNext()Z

    move-result v0

    if-eqz v0, :cond_1d

    invoke-interface {v1}, Ljava/util/Iterator;->next()Ljava/lang/Object;

    move-result-object v0

    check-cast v0, Ldressi/Value;

    iget-object v2, v0, Ldressi/Value;->name:Ljava/lang/String;

    invoke-virtual {v2, p1}, Ljava/lang/String;->equals(Ljava/lang/Object;)Z

    move-result v2

    if-eqz v2, :cond_8

    :goto_1c
    return-object v0

    :cond_1d
    const/4 v0, 0x0

    goto :goto_1c
.end method

.method public get(Ljava/lang/String;Ljava/nio/ByteBuffer;)V
    .registers 9

    invoke-direct {p0}, Ldressi/Session;->begin()J

    move-result-wide v0

    :try_start_4
    invoke-virtual {p2}, Ljava/nio/ByteBuffer;->position()I

    move-result v4

    invoke-virtual {p2}, Ljava/nio/ByteBuffer;->remaining()I

    move-result v5

    move-object v2, p1

    move-object v3, p2

    invoke-static/range {v0 .. v5}, Ldressi/Session;->get(JLjava/lang/String;Ljava/nio/ByteBuffer;II)V
    :try_end_11
    .catchall {:try_start_4 .. :try_end_11} :catchall_15

    invoke-direct {p0}, Ldressi/Session;->end()V

    return-void

    :catchall_15
    move-exception v0

    invoke-direct {p0}, Ldressi/Session;->end()V

    throw v0
.end method

.method public loss()F
    .registers 3

    invoke-direct {p0}, Ldressi/Session;->begin()J

    move-result-wide v0

    :try_start_4
    invoke-static {v0, v1}, Ldressi/Session;->loss(J)F
    :try_end_7
    .catchall {:try_start_4 .. :try_end_7} :catchall_c

    move-result v0

    invoke-direct {p0}, Ldressi/Session;->end()V

    return v0

    :catchall_c
    move-exception v0

    invoke-direct {p0}, Ldressi/Session;->end()V

    throw v0
.end method

.method public phases()Ljava/util/List;
    .registers 6
    .annotation system Ldalvik/annotation/Signature;
        value = {
            "()",
            "Ljava/util/List",
            "<",
            "Ljava/lang/String;",
            ">;"
        }
    .end annotation

    invoke-direct {p0}, Ldressi/Session;->begin()J

    move-result-wide v0

    :try_start_4
    new-instance v2, Ljava/util/ArrayList;

    invoke-direct {v2}, Ljava/util/ArrayList;-><init>()V

    :goto_9
    invoke-interface {v2}, Ljava/util/List;->size()I

    move-result v3

    const/4 v4, 0x1

    new-array v4, v4, [J

    invoke-static {v0, v1, v3, v4}, Ldressi/Session;->phase(JI[J)Ljava/lang/String;

    move-result-object v3

    if-eqz v3, :cond_1f

    invoke-interface {v2, v3}, Ljava/util/List;->add(Ljava/lang/Object;)Z
    :try_end_19
    .catchall {:try_start_4 .. :try_end_19} :catchall_1a

    goto :goto_9

    :catchall_1a
    move-exception v0

    invoke-direct {p0}, Ldressi/Session;->end()V

    throw v0

    :cond_1f
    invoke-direct {p0}, Ldressi/Session;->end()V

    return-object v2
.end method

.method public report()Ljava/lang/String;
    .registers 3

    invoke-direct {p0}, Ldressi/Session;->begin()J

    move-result-wide v0

    :try_start_4
    invoke-static {v0, v1}, Ldressi/Session;->report(J)Ljava/lang/String;
    :try_end_7
    .catchall {:try_start_4 .. :try_end_7} :catchall_c

    move-result-object v0

    invoke-direct {p0}, Ldressi/Session;->end()V

    return-object v0

    :catchall_c
    move-exception v0

    invoke-direct {p0}, Ldressi/Session;->end()V

    throw v0
.end method

.method public restore(Ljava/lang/String;)V
    .registers 4

    invoke-direct {p0}, Ldressi/Session;->begin()J

    move-result-wide v0

    :try_start_4
    invoke-static {v0, v1, p1}, Ldressi/Session;->restore(JLjava/lang/String;)V
    :try_end_7
    .catchall {:try_start_4 .. :try_end_7} :catchall_b

    invoke-direct {p0}, Ldressi/Session;->end()V

    return-void

    :catchall_b
    move-exception v0

    invoke-direct {p0}, Ldressi/Session;->end()V

    throw v0
.end method

.method public set(Ljava/lang/String;Ljava/nio/ByteBuffer;)V
    .registers 9

    invoke-direct {p0}, Ldressi/Session;->begin()J

    move-result-wide v0

    :try_start_4
    invoke-virtual {p2}, Ljava/nio/ByteBuffer;->position()I

    move-result v4

    invoke-virtual {p2}, Ljava/nio/ByteBuffer;->remaining()I

    move-result v5

    move-object v2, p1

    move-object v3, p2

    invoke-static/range {v0 .. v5}, Ldressi/Session;->set(JLjava/lang/String;Ljava/nio/ByteBuffer;II)V
    :try_end_11
    .catchall {:try_start_4 .. :try_end_11} :catchall_15

    invoke-direct {p0}, Ldressi/Session;->end()V

    return-void

    :catchall_15
    move-exception v0

    invoke-direct {p0}, Ldressi/Session;->end()V

    throw v0
.end method

.method public step(JLjava/lang/String;DLjava/util/concurrent/atomic/AtomicBoolean;)J
    .registers 15

    invoke-direct {p0}, Ldressi/Session;->begin()J

    move-result-wide v0

    move-wide v2, p1

    move-object v4, p3

    move-wide v5, p4

    move-object v7, p6

    :try_start_8
    invoke-static/range {v0 .. v7}, Ldressi/Session;->step(JJLjava/lang/String;DLjava/util/concurrent/atomic/AtomicBoolean;)J
    :try_end_b
    .catchall {:try_start_8 .. :try_end_b} :catchall_10

    move-result-wide v0

    invoke-direct {p0}, Ldressi/Session;->end()V

    return-wide v0

    :catchall_10
    move-exception v0

    invoke-direct {p0}, Ldressi/Session;->end()V

    throw v0
.end method

.method public step(JLjava/lang/String;)V
    .registers 11

    const-wide/high16 v4, -0x4010000000000000L    # -1.0

    const/4 v6, 0x0

    move-object v0, p0

    move-wide v1, p1

    move-object v3, p3

    invoke-virtual/range {v0 .. v6}, Ldressi/Session;->step(JLjava/lang/String;DLjava/util/concurrent/atomic/AtomicBoolean;)J

    return-void
.end method

.method public steps(Ljava/lang/String;)J
    .registers 7

    const/4 v0, 0x0

    invoke-direct {p0}, Ldressi/Session;->begin()J

    move-result-wide v2

    const/4 v1, 0x1

    :try_start_6
    new-array v1, v1, [J

    :goto_8
    invoke-static {v2, v3, v0, v1}, Ldressi/Session;->phase(JI[J)Ljava/lang/String;

    move-result-object v4

    if-eqz v4, :cond_1e

    invoke-virtual {v4, p1}, Ljava/lang/String;->equals(Ljava/lang/Object;)Z

    move-result v4

    if-eqz v4, :cond_1b

    const/4 v0, 0x0

    aget-wide v0, v1, v0
    :try_end_17
    .catchall {:try_start_6 .. :try_end_17} :catchall_24

    invoke-direct {p0}, Ldressi/Session;->end()V

    :goto_1a
    return-wide v0

    :cond_1b
    add-int/lit8 v0, v0, 0x1

    goto :goto_8

    :cond_1e
    const-wide/16 v0, 0x0

    invoke-direct {p0}, Ldressi/Session;->end()V

    goto :goto_1a

    :catchall_24
    move-exception v0

    invoke-direct {p0}, Ldressi/Session;->end()V

    throw v0
.end method

.method public values()Ljava/util/List;
    .registers 8
    .annotation system Ldalvik/annotation/Signature;
        value = {
            "()",
            "Ljava/util/List",
            "<",
            "Ldressi/Value;",
            ">;"
        }
    .end annotation

    invoke-direct {p0}, Ldressi/Session;->begin()J

    move-result-wide v0

    :try_start_4
    new-instance v2, Ljava/util/ArrayList;

    invoke-direct {v2}, Ljava/util/ArrayList;-><init>()V

    const/4 v3, 0x1

    new-array v3, v3, [Ljava/lang/String;

    :goto_c
    invoke-interface {v2}, Ljava/util/List;->size()I

    move-result v4

    invoke-static {v0, v1, v4, v3}, Ldressi/Session;->value(JI[Ljava/lang/String;)[I

    move-result-object v4

    if-eqz v4, :cond_27

    new-instance v5, Ldressi/Value;

    const/4 v6, 0x0

    aget-object v6, v3, v6

    invoke-direct {v5, v6, v4}, Ldressi/Value;-><init>(Ljava/lang/String;[I)V

    invoke-interface {v2, v5}, Ljava/util/List;->add(Ljava/lang/Object;)Z
    :try_end_21
    .catchall {:try_start_4 .. :try_end_21} :catchall_22

    goto :goto_c

    :catchall_22
    move-exception v0

    invoke-direct {p0}, Ldressi/Session;->end()V

    throw v0

    :cond_27
    invoke-direct {p0}, Ldressi/Session;->end()V

    return-object v2
.end method
